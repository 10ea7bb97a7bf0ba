// SPDX-License-Identifier: MIT
// Residuals of preintegrated motions between extended poses, with the derivatives of all they depend on.
#pragma once
#include <cstddef>

#include "imu/preintegrate.hpp"

namespace heliograph {

// A preintegrated motion as a factor keeps it, one row of doubles, matrices row by row.
struct MotionRow {
  static constexpr size_t kR = 0, kP = 9, kV = 12, kTimes = 15, kBias = 18, kByBias = 24, kRange = 78, kCount = 80, kEnd = 81,
                          kModel = 82, kSize = kModel + kImuModelNumbers;
};

constexpr size_t kSampleNumbers = 7;  // stamp from the interval's start [ns], rate, specific force

struct MotionFactors {
  size_t count, samples;   // samples: rows kept of each, some of them unused
  const double* X_i;       // (N, 5, 5)
  const double* X_j;       // (N, 5, 5)
  const double* bias;      // (N, 6) gyro, accelerometer
  const double* gravity;   // (N, 3)
  const double* motion;    // (N, MotionRow::kSize)
  const double* sampled;   // (N, samples, 7)
};

struct MotionJacobians {  // row by row; null where they are not wanted
  double* by_i = nullptr;        // (N, 9, 9)
  double* by_j = nullptr;        // (N, 9, 9)
  double* by_bias = nullptr;     // (N, 9, 6)
  double* by_gravity = nullptr;  // (N, 9, 3)
};

// residual (N, 9) = Log(delta(bias)^-1 (X_i^-1 X_j without gravity)).
void evaluate_motions(const MotionFactors& factors, double* residual, const MotionJacobians& out);

}  // namespace heliograph
