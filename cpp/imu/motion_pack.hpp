// SPDX-License-Identifier: MIT
// Preintegrated motions as the rows that their factors keep: motion_row.hpp, known gravity, and the samples they came from.
#pragma once
#include <cstdint>
#include <span>

#include "imu/motion_row.hpp"
#include "imu/signal.hpp"

namespace heliograph {

struct MotionArrays {
  size_t count;
  const int64_t* start_ns;
  const int64_t* end_ns;
  const double* R;           // (N, 3, 3)
  const double* p;           // (N, 3)
  const double* v;           // (N, 3)
  const double* times[3];    // duration, of gravity, its integral, each (N)
  const double* gyro_bias;   // (N, 3)
  const double* accel_bias;  // (N, 3)
  const double* by_bias;     // (N, 9, 6)
  const double* covariance;  // (N, 9, 9)
  const double* model;       // kImuModelNumbers, of all
};

// Rows of samples that are kept of each motion: a power of two, so that factors of alike intervals are one group.
size_t sample_rows(const ImuSamples& samples, const MotionArrays& motions);

// How far the biases may change before the correction to first order is off by a share of the motion's standard deviation:
// (a, b) with a |dg|^2 + b |dg| |da| < 1. Bounds of the second order over time T under a mean force A: of the turn |dg|^2 T^2/2,
// of the velocity A |dg|^2 T^3/6 + |dg| |da| T^2/2, of the position that integrated once more.
void linear_range(const double* covariance, double duration, double force, double share, double* range);

// `out` is (N, MotionRow::kSize + known + kSampleNumbers rows); `gravity` (known) follows each row. Returns whether all is finite.
bool pack_motions(const ImuSamples& samples, const MotionArrays& motions, std::span<const double> gravity, double share, size_t rows,
                  double* out);

// The state at the end of a motion, its biases changed to first order. X and out are 5 x 5 matrices, row by row.
void predict_state(const double* R, const double* p, const double* v, const double* const* times, const double* by_bias,
                   const double* change, const double* X, const double* gravity, double* out);

}  // namespace heliograph
