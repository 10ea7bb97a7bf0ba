// SPDX-License-Identifier: MIT
#include "imu/propagate.hpp"

#include <algorithm>
#include <cmath>

namespace heliograph {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Matrix3d hat(const Vector3d& w) {
  Matrix3d m;
  m << 0.0, -w.z(), w.y(), w.z(), 0.0, -w.x(), -w.y(), w.x(), 0.0;
  return m;
}

// sin(a)/a and (1 - cos(a))/a^2 and (a - sin(a))/a^3, without cancellation near zero.
struct Rodrigues {
  double s, c, d;
  explicit Rodrigues(double a2) {
    if (a2 < 1e-4) {
      s = 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0);
      c = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0);
      d = 1.0 / 6.0 - a2 / 120.0 * (1.0 - a2 / 42.0);
    } else {
      const double a = std::sqrt(a2);
      s = std::sin(a) / a;
      c = (1.0 - std::cos(a)) / a2;
      d = (1.0 - s) / a2;
    }
  }
};

Matrix3d rotation_exp(const Vector3d& w) {
  const Rodrigues k(w.squaredNorm());
  const Matrix3d h = hat(w);
  return Matrix3d::Identity() + k.s * h + k.c * h * h;
}

Matrix3d right_jacobian(const Vector3d& w) {
  const Rodrigues k(w.squaredNorm());
  const Matrix3d h = hat(w);
  return Matrix3d::Identity() - k.c * h + k.d * h * h;
}

struct Reading {
  Vector3d gyro;
  Vector3d accel;
};

// The samples as a continuous signal.
class Signal {
 public:
  Signal(const ImuSamples& samples, int64_t max_gap_ns) : samples_(samples), max_gap_ns_(max_gap_ns) {}

  // Index of the first sample after t.
  size_t after(int64_t t) const {
    const auto& s = samples_.stamps_ns;
    return static_cast<size_t>(std::upper_bound(s.begin(), s.end(), t) - s.begin());
  }

  Reading at(int64_t t) const {
    const size_t n = samples_.stamps_ns.size();
    const size_t j = after(t);
    if (j == 0) return sample(0);
    if (j == n) return sample(n - 1);
    const int64_t before = t - samples_.stamps_ns[j - 1], until = samples_.stamps_ns[j] - t;
    if (before + until > max_gap_ns_) return sample(before <= until ? j - 1 : j);
    const double s = static_cast<double>(before) / static_cast<double>(before + until);
    const Reading a = sample(j - 1), b = sample(j);
    return {a.gyro + s * (b.gyro - a.gyro), a.accel + s * (b.accel - a.accel)};
  }

  // Distance to the nearest sample [ns].
  int64_t distance(int64_t t) const {
    const auto& s = samples_.stamps_ns;
    const size_t j = after(t);
    const int64_t before = j == 0 ? INT64_MAX : t - s[j - 1];
    const int64_t until = j == s.size() ? INT64_MAX : s[j] - t;
    return std::min(before, until);
  }

  // Whether the signal around t is held or bridged, and how much it changes from one sample to the next there.
  bool held(int64_t t) const {
    const size_t j = after(t);
    if (j == 0 || j == samples_.stamps_ns.size()) return true;
    return samples_.stamps_ns[j] - samples_.stamps_ns[j - 1] > max_gap_ns_;
  }

  Reading change(int64_t t) const {
    const size_t j = after(t);
    if (j == 0 || j == samples_.stamps_ns.size()) return {Vector3d::Zero(), Vector3d::Zero()};
    const Reading a = sample(j - 1), b = sample(j);
    return {b.gyro - a.gyro, b.accel - a.accel};
  }

  double period(int64_t t) const {
    const size_t j = after(t);
    if (j == 0 || j == samples_.stamps_ns.size()) return 0.0;
    return 1e-9 * static_cast<double>(samples_.stamps_ns[j] - samples_.stamps_ns[j - 1]);
  }

 private:
  Reading sample(size_t i) const {
    return {Vector3d(samples_.gyro + 3 * i), Vector3d(samples_.accel + 3 * i)};
  }
  const ImuSamples& samples_;
  int64_t max_gap_ns_;
};

// t0, every sample in between, t1, with longer steps divided evenly.
std::vector<int64_t> time_grid(const ImuSamples& samples, int64_t t0, int64_t t1, double max_step) {
  std::vector<int64_t> knots{t0};
  for (const int64_t t : samples.stamps_ns)
    if (t > t0 && t < t1) knots.push_back(t);
  if (t1 > t0) knots.push_back(t1);
  const auto step = static_cast<int64_t>(max_step * 1e9);
  std::vector<int64_t> grid{t0};
  for (size_t i = 1; i < knots.size(); ++i) {
    const int64_t span = knots[i] - knots[i - 1];
    // The tolerance keeps a nominal period with jitter from being split in two.
    const int64_t parts = std::max<int64_t>(1, (span + step - 1 - step / 4) / step);
    for (int64_t k = 1; k <= parts; ++k) grid.push_back(knots[i - 1] + span * k / parts);
  }
  return grid;
}

// Error dynamics of one step: the exact derivative of what the step does, for a right perturbation of the rotation and
// gravity on the sphere (to first order in dt it is Sola 2017, Quaternion kinematics for the error-state KF, eq. 268-270).
NavMatrix step_transition(const NavState& x, const Matrix3d& half_turn, const Vector3d& rate, const Vector3d& force,
                          double dt) {
  NavMatrix F = NavMatrix::Identity();
  const Matrix3d R_mid = x.R_odom_imu * half_turn;
  const Matrix3d lever = -x.R_odom_imu * hat(half_turn * force);
  const Matrix3d by_gyro_bias = 0.5 * dt * R_mid * hat(force) * right_jacobian(0.5 * dt * rate);
  F.block<3, 3>(0, 0) = rotation_exp(-rate * dt);
  F.block<3, 3>(0, 9) = -right_jacobian(rate * dt) * dt;
  F.block<3, 3>(3, 0) = 0.5 * dt * dt * lever;
  F.block<3, 3>(3, 6) = dt * Matrix3d::Identity();
  F.block<3, 3>(3, 9) = 0.5 * dt * dt * by_gyro_bias;
  F.block<3, 3>(3, 12) = -0.5 * dt * dt * R_mid;
  F.block<3, 2>(3, 15) = 0.5 * dt * dt * x.g_basis;
  F.block<3, 3>(6, 0) = dt * lever;
  F.block<3, 3>(6, 9) = dt * by_gyro_bias;
  F.block<3, 3>(6, 12) = -dt * R_mid;
  F.block<3, 2>(6, 15) = dt * x.g_basis;
  return F;
}

// Coasting goes on as it went, whatever heading, biases and gravity are: their errors do not reach the velocity.
NavMatrix coasting_transition(double dt) {
  NavMatrix F = NavMatrix::Identity();
  F.block<3, 3>(3, 6) = dt * Matrix3d::Identity();
  return F;
}

void add_step_noise(NavMatrix& Q, double gyro_var, double accel_var, const ImuModel& model, double dt) {
  Q.diagonal().segment<3>(0).array() += gyro_var * dt;
  Q.diagonal().segment<3>(3).array() += accel_var * dt * dt * dt / 3.0;
  Q.diagonal().segment<3>(6).array() += accel_var * dt;
  const double cross = 0.5 * accel_var * dt * dt;
  for (int i = 0; i < 3; ++i) {
    Q(3 + i, 6 + i) += cross;
    Q(6 + i, 3 + i) += cross;
  }
  Q.diagonal().segment<3>(9).array() += model.gyro_walk_var * dt;
  Q.diagonal().segment<3>(12).array() += model.accel_walk_var * dt;
}

void append(Propagation& out, const NavState& x) {
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) out.R.push_back(x.R_odom_imu(r, c));
  for (int i = 0; i < 3; ++i) out.p.push_back(x.p_odom[i]);
  for (int i = 0; i < 3; ++i) out.v.push_back(x.v_odom[i]);
}

}  // namespace

Propagation propagate(const NavState& start, const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns,
                      const ImuModel& model) {
  Propagation out;
  NavState x = start;
  const Signal signal(samples, model.max_gap_ns);
  out.stamps_ns = time_grid(samples, t0_ns, t1_ns, model.max_step);
  out.transition.setIdentity();
  out.noise.setZero();
  append(out, x);
  for (size_t k = 1; k < out.stamps_ns.size(); ++k) {
    const int64_t from = out.stamps_ns[k - 1], to = out.stamps_ns[k], middle = from + (to - from) / 2;
    const double dt = 1e-9 * static_cast<double>(to - from);
    const Reading reading = signal.at(middle);
    const bool held = signal.held(middle);
    Vector3d rate = reading.gyro - x.gyro_bias;
    Vector3d force = reading.accel - x.accel_bias;
    const bool coasting = held && signal.distance(middle) > model.hold_ns;
    if (coasting) {
      rate.setZero();
      force = -x.R_odom_imu.transpose() * x.g_odom;
    }
    const Matrix3d half_turn = rotation_exp(0.5 * dt * rate);
    const Vector3d acceleration = x.R_odom_imu * half_turn * force + x.g_odom;

    // What lies between two samples is unknown: linear interpolation misses a share of the change from one to the next.
    const Reading change = signal.change(middle);
    const double missed = model.curvature * model.curvature * signal.period(middle) / 3.0;
    const double gyro_var = model.gyro_var + missed * change.gyro.squaredNorm() + (held ? model.held_gyro_var : 0.0);
    const double accel_var = model.accel_var + missed * change.accel.squaredNorm() + (held ? model.held_accel_var : 0.0);
    const NavMatrix F = coasting ? coasting_transition(dt) : step_transition(x, half_turn, rate, force, dt);
    out.transition = F * out.transition;
    out.noise = F * out.noise * F.transpose();
    add_step_noise(out.noise, gyro_var, accel_var, model, dt);
    if (held) out.held_s += dt;

    x.p_odom += dt * x.v_odom + 0.5 * dt * dt * acceleration;
    x.v_odom += dt * acceleration;
    x.R_odom_imu *= rotation_exp(dt * rate);
    append(out, x);
  }
  return out;
}

}  // namespace heliograph
