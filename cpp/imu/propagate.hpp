// SPDX-License-Identifier: MIT
// Inertial propagation of a navigation state and its error covariance over one interval.
#pragma once
#include <Eigen/Dense>
#include <cstdint>
#include <vector>

#include "imu/signal.hpp"

namespace heliograph {

constexpr int kNavDim = 17;  // rotation 3, position 3, velocity 3, gyro bias 3, accelerometer bias 3, gravity direction 2
using NavMatrix = Eigen::Matrix<double, kNavDim, kNavDim>;

struct NavState {
  Eigen::Matrix3d R_odom_imu;
  Eigen::Vector3d p_odom;
  Eigen::Vector3d v_odom;
  Eigen::Vector3d gyro_bias;
  Eigen::Vector3d accel_bias;
  Eigen::Vector3d g_odom;
  Eigen::Matrix<double, 3, 2> g_basis;  // d g_odom / d (tangent of S(2))
};

struct Propagation {
  std::vector<int64_t> stamps_ns;      // K, from t0 to t1
  std::vector<double> R;               // (K, 3, 3)
  std::vector<double> p;               // (K, 3)
  std::vector<double> v;               // (K, 3)
  NavMatrix transition;                // error at t1 from error at t0
  NavMatrix noise;                     // covariance added on the way
  double held_s = 0.0;                 // time without samples
};

// Integrates from t0 to t1 with the midpoint rule on linearly interpolated samples. Outside them, and in gaps, the nearest
// sample is held for a short while; then the body coasts, without rotation or acceleration, which is the better guess.
Propagation propagate(const NavState& start, const ImuSamples& samples, int64_t t0_ns, int64_t t1_ns, const ImuModel& model);

}  // namespace heliograph
