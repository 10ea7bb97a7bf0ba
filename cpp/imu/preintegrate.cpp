// SPDX-License-Identifier: MIT
// Errors are carried as perturbations on the left of the delta, eta = (turn, position, velocity). There they do not depend
// on the motion (Barrau and Bonnabel 2017): from any step to the end only tau, the time left, times the velocity is added
// to the position. So covariances are sums over the steps instead of products of matrices; docs/theory/imu.md has them.
#include "imu/preintegrate.hpp"

namespace heliograph {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// d(eta) / d(biases) up to now; the accelerometer's turns nothing.
struct BiasEffect {
  Matrix3d turn_by_gyro = Matrix3d::Zero(), p_by_gyro = Matrix3d::Zero(), v_by_gyro = Matrix3d::Zero();
  Matrix3d p_by_accel = Matrix3d::Zero(), v_by_accel = Matrix3d::Zero();
};

// hat(v) M: its columns are crossed with v.
Matrix3d crossed(const Vector3d& v, const Matrix3d& M) {
  Matrix3d out;
  for (int c = 0; c < 3; ++c) {
    const double x = M(0, c), y = M(1, c), z = M(2, c);
    out(0, c) = v.y() * z - v.z() * y;
    out(1, c) = v.z() * x - v.x() * z;
    out(2, c) = v.x() * y - v.y() * x;
  }
  return out;
}

// M hat(v): its rows are crossed with v.
Matrix3d crossed(const Matrix3d& M, const Vector3d& v) {
  Matrix3d out;
  out.col(0) = M.col(1) * v.z() - M.col(2) * v.y();
  out.col(1) = M.col(2) * v.x() - M.col(0) * v.z();
  out.col(2) = M.col(0) * v.y() - M.col(1) * v.x();
  return out;
}

void coast(ImuDelta& delta, BiasEffect& bias, double dt) {
  delta.p += dt * delta.v;
  delta.gravity_s2 += dt * delta.gravity_s;
  bias.p_by_gyro += dt * bias.v_by_gyro;
  bias.p_by_accel += dt * bias.v_by_accel;
}

// One step of the midpoint rule, and its derivative by the biases.
void advance(ImuDelta& delta, BiasEffect& effect, const ImuStep& step, const ImuBias& bias) {
  const double dt = step.dt, half_dt2 = 0.5 * dt * dt;
  delta.duration_s += dt;
  if (step.held) delta.held_s += dt;
  if (step.coasting) return coast(delta, effect, dt);
  const Vector3d force = step.accel - bias.accel;
  const StepTurn turn(step.gyro - bias.gyro, dt);
  const Matrix3d R_mid = delta.R * turn.half;
  const Vector3d acceleration = R_mid * force;
  delta.p += dt * delta.v + half_dt2 * acceleration;
  delta.v += dt * acceleration;
  delta.R *= turn.whole;
  delta.gravity_s2 += dt * delta.gravity_s + half_dt2;
  delta.gravity_s += dt;

  const Matrix3d turned = -dt * (delta.R * turn.whole_jacobian);
  const Matrix3d pushed = 0.5 * dt * (crossed(R_mid, force) * turn.half_jacobian);
  effect.p_by_gyro += dt * effect.v_by_gyro + half_dt2 * pushed + crossed(delta.p, turned);
  effect.v_by_gyro += dt * pushed + crossed(delta.v, turned);
  effect.turn_by_gyro += turned;
  effect.p_by_accel += dt * effect.v_by_accel - half_dt2 * R_mid;
  effect.v_by_accel -= dt * R_mid;
}

// What white noise of the steps adds at the end: sums, from which the covariance of eta is made.
struct WhiteNoise {
  double turn = 0.0, pp = 0.0, pv = 0.0, vv = 0.0;  // variance of the turn; of position and velocity by the force
  Vector3d u = Vector3d::Zero(), v = Vector3d::Zero();
  Matrix3d uu = Matrix3d::Zero(), uv = Matrix3d::Zero(), v2 = Matrix3d::Zero();

  // A turn at this step moves what follows: at the end it shows as hat(u) and hat(v) of it, u = p + tau v.
  void add(const ImuDelta& delta, const ImuStep& step, double tau) {
    const double q = step.gyro_var * step.dt, a = step.accel_var, dt = step.dt;
    const Vector3d lever = delta.p + tau * delta.v, weighed = q * lever, weighed_v = q * delta.v;
    turn += q;
    u += weighed;
    v += weighed_v;
    uu += weighed * lever.transpose();
    uv += weighed * delta.v.transpose();
    v2 += weighed_v * delta.v.transpose();
    pp += a * dt * (dt * dt / 3.0 + tau * (dt + tau));
    pv += a * dt * (0.5 * dt + tau);
    vv += a * dt;
  }

  Matrix99 covariance() const {
    const Matrix3d I = Matrix3d::Identity();
    Matrix99 P;
    P.block<3, 3>(0, 0) = turn * I;
    P.block<3, 3>(3, 0) = hat(u);
    P.block<3, 3>(6, 0) = hat(v);
    P.block<3, 3>(3, 3) = (uu.trace() + pp) * I - uu;
    P.block<3, 3>(6, 3) = (uv.trace() + pv) * I - uv;  // hat(v) hat(u)' = (u.v) I - u v'
    P.block<3, 3>(6, 6) = (v2.trace() + vv) * I - v2;
    P.triangularView<Eigen::StrictlyUpper>() = P.transpose();
    return P;
  }
};

// What walking biases add at the end. A step of the walk acts as the bias of all steps after it: the whole effect less the
// effect up to then, carried to the end. Sums of that effect and of its square over time are all that is needed.
struct BiasWalk {
  Matrix93 gyro = Matrix93::Zero();
  Eigen::Matrix<double, 6, 3> accel = Eigen::Matrix<double, 6, 3>::Zero();
  Matrix99 gyro2 = Matrix99::Zero();  // upper triangles
  Eigen::Matrix<double, 6, 6> accel2 = Eigen::Matrix<double, 6, 6>::Zero();

  void add(const BiasEffect& effect, double dt, double tau) {
    Matrix93 by_gyro;
    by_gyro.topRows<3>() = effect.turn_by_gyro;
    by_gyro.middleRows<3>(3) = effect.p_by_gyro + tau * effect.v_by_gyro;
    by_gyro.bottomRows<3>() = effect.v_by_gyro;
    Eigen::Matrix<double, 6, 3> by_accel;
    by_accel.topRows<3>() = effect.p_by_accel + tau * effect.v_by_accel;
    by_accel.bottomRows<3>() = effect.v_by_accel;
    gyro += dt * by_gyro;
    accel += dt * by_accel;
    add_square(gyro2, by_gyro, dt);
    add_square(accel2, by_accel, dt);
  }

  template <int Rows>
  static void add_square(Eigen::Matrix<double, Rows, Rows>& sum, const Eigen::Matrix<double, Rows, 3>& B, double dt) {
    for (int c = 0; c < Rows; ++c) {
      const double x = dt * B(c, 0), y = dt * B(c, 1), z = dt * B(c, 2);
      for (int r = 0; r <= c; ++r) sum(r, c) += x * B(r, 0) + y * B(r, 1) + z * B(r, 2);
    }
  }
};

// The covariance of (eta, change of the bias) by one bias: `end` is its whole effect, `first` and `second` the sums.
template <int Rows>
void add_walk(Matrix15& P, int row, int bias, const Eigen::Matrix<double, Rows, 3>& end, const Eigen::Matrix<double, Rows, 3>& first,
              const Eigen::Matrix<double, Rows, Rows>& second, double var, double duration) {
  const Eigen::Matrix<double, Rows, Rows> crossing = end * first.transpose();
  Eigen::Matrix<double, Rows, Rows> square = second;
  square.template triangularView<Eigen::StrictlyLower>() = second.transpose();
  P.block<Rows, Rows>(row, row) += var * (duration * (end * end.transpose()) - crossing - crossing.transpose() + square);
  P.block<Rows, 3>(row, bias) = var * (duration * end - first);
  P.block<3, Rows>(bias, row) = P.block<Rows, 3>(row, bias).transpose();
  P.block<3, 3>(bias, bias).diagonal().array() = var * duration;
}

Matrix93 by_gyro(const BiasEffect& effect) {
  Matrix93 out;
  out << effect.turn_by_gyro, effect.p_by_gyro, effect.v_by_gyro;
  return out;
}

Eigen::Matrix<double, 6, 3> by_accel(const BiasEffect& effect) {
  Eigen::Matrix<double, 6, 3> out;
  out << effect.p_by_accel, effect.v_by_accel;
  return out;
}

void finish(ImuDelta& delta, const BiasEffect& effect) {
  Matrix96 on_left = Matrix96::Zero();
  on_left.leftCols<3>() = by_gyro(effect);
  on_left.bottomRightCorner<6, 3>() = by_accel(effect);
  delta.by_bias = adjoint_of_inverse(delta.R, delta.p, delta.v) * on_left;
}

}  // namespace

Matrix99 adjoint_of_inverse(const Matrix3d& R, const Vector3d& p, const Vector3d& v) {
  Matrix99 A = Matrix99::Zero();
  const Matrix3d back = R.transpose();
  for (int k = 0; k < 9; k += 3) A.block<3, 3>(k, k) = back;
  A.block<3, 3>(3, 0) = -crossed(back, p);
  A.block<3, 3>(6, 0) = -crossed(back, v);
  return A;
}

ImuDelta preintegrate_delta(const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns, const ImuBias& bias, const ImuModel& model) {
  ImuDelta delta;
  BiasEffect effect;
  ImuWalk walk(samples, model, t0_ns, t1_ns);
  for (ImuStep step; walk.next(step);) advance(delta, effect, step, bias);
  finish(delta, effect);
  return delta;
}

Preintegrated preintegrate(const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns, const ImuBias& bias, const ImuModel& model) {
  Preintegrated out;
  ImuDelta& delta = out.delta;
  BiasEffect effect;
  WhiteNoise white;
  BiasWalk walked;
  ImuWalk walk(samples, model, t0_ns, t1_ns);
  for (ImuStep step; walk.next(step);) {
    advance(delta, effect, step, bias);
    const double tau = 1e-9 * static_cast<double>(t1_ns - step.to_ns);
    white.add(delta, step, tau);
    walked.add(effect, step.dt, tau);
  }
  finish(delta, effect);
  const Matrix99 to_right = adjoint_of_inverse(delta.R, delta.p, delta.v);
  const Matrix99 P = white.covariance();
  out.covariance = to_right * P * to_right.transpose();
  Matrix15 combined = Matrix15::Zero();
  combined.topLeftCorner<9, 9>() = P;
  add_walk<9>(combined, 0, 9, by_gyro(effect), walked.gyro, walked.gyro2, model.gyro_walk_var, delta.duration_s);
  add_walk<6>(combined, 3, 12, by_accel(effect), walked.accel, walked.accel2, model.accel_walk_var, delta.duration_s);
  combined.topRows<9>() = to_right * combined.topRows<9>();
  combined.leftCols<9>() = combined.leftCols<9>() * to_right.transpose();
  out.combined = 0.5 * (combined + combined.transpose());
  out.covariance = 0.5 * (out.covariance + out.covariance.transpose()).eval();
  return out;
}

}  // namespace heliograph
