// SPDX-License-Identifier: MIT
#include "imu/propagate.hpp"

namespace heliograph {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Error dynamics of one step: the exact derivative of what the step does, for a right perturbation of the rotation and
// gravity on the sphere (to first order in dt it is Sola 2017, Quaternion kinematics for the error-state KF, eq. 268-270).
NavMatrix step_transition(const NavState& x, const StepTurn& turn, const Vector3d& force, double dt) {
  NavMatrix F = NavMatrix::Identity();
  const Matrix3d R_mid = x.R_odom_imu * turn.half;
  const Matrix3d lever = -x.R_odom_imu * hat(turn.half * force);
  const Matrix3d by_gyro_bias = 0.5 * dt * R_mid * hat(force) * turn.half_jacobian;
  F.block<3, 3>(0, 0) = turn.whole.transpose();
  F.block<3, 3>(0, 9) = -turn.whole_jacobian * dt;
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
  ImuWalk walk(samples, model, t0_ns, t1_ns);
  out.stamps_ns.push_back(t0_ns);
  out.transition.setIdentity();
  out.noise.setZero();
  append(out, x);
  for (ImuStep step; walk.next(step);) {
    const double dt = step.dt;
    Vector3d rate = step.gyro - x.gyro_bias;
    Vector3d force = step.accel - x.accel_bias;
    if (step.coasting) {
      rate.setZero();
      force = -x.R_odom_imu.transpose() * x.g_odom;
    }
    const StepTurn turn(rate, dt);
    const Vector3d acceleration = x.R_odom_imu * turn.half * force + x.g_odom;
    const NavMatrix F = step.coasting ? coasting_transition(dt) : step_transition(x, turn, force, dt);
    out.transition = F * out.transition;
    out.noise = F * out.noise * F.transpose();
    add_step_noise(out.noise, step.gyro_var, step.accel_var, model, dt);
    if (step.held) out.held_s += dt;

    x.p_odom += dt * x.v_odom + 0.5 * dt * dt * acceleration;
    x.v_odom += dt * acceleration;
    x.R_odom_imu *= turn.whole;
    out.stamps_ns.push_back(step.to_ns);
    append(out, x);
  }
  return out;
}

}  // namespace heliograph
