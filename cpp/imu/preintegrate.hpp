// SPDX-License-Identifier: MIT
// Preintegration: what the samples between two instants say of the motion, whatever the state at the first one is.
#pragma once
#include <Eigen/Dense>
#include <cstdint>

#include "imu/signal.hpp"

namespace heliograph {

using Matrix93 = Eigen::Matrix<double, 9, 3>;
using Matrix96 = Eigen::Matrix<double, 9, 6>;
using Matrix99 = Eigen::Matrix<double, 9, 9>;
using Matrix15 = Eigen::Matrix<double, 15, 15>;

// Rotation, position and velocity gained in the frame of the start, without gravity: an element of SE_2(3).
struct ImuDelta {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  Eigen::Vector3d v = Eigen::Vector3d::Zero();
  double duration_s = 0.0;
  double gravity_s = 0.0;   // gravity adds g times this to the velocity
  double gravity_s2 = 0.0;  // ... and g times this to the position: coasting knows no gravity
  double held_s = 0.0;
  Matrix96 by_bias = Matrix96::Zero();  // of its right perturbation, by gyro bias and accelerometer bias
};

struct ImuBias {
  Eigen::Vector3d gyro;
  Eigen::Vector3d accel;
};

// The delta and its derivative, exact for the discrete scheme.
ImuDelta preintegrate_delta(const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns, const ImuBias& bias, const ImuModel& model);

struct Preintegrated {
  ImuDelta delta;
  Matrix99 covariance;  // of its right perturbation (rotation, position, velocity), the bias known
  Matrix15 combined;    // of that and of the change of the biases, which walk from what is known at the start
};

Preintegrated preintegrate(const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns, const ImuBias& bias, const ImuModel& model);

// Ad of the inverse of an extended pose: takes perturbations on its left to its right.
Matrix99 adjoint_of_inverse(const Eigen::Matrix3d& R, const Eigen::Vector3d& p, const Eigen::Vector3d& v);

}  // namespace heliograph
