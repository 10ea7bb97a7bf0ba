// SPDX-License-Identifier: MIT
// A preintegrated motion as its factor keeps it, and what the factor's kernels need of it far from where it was integrated.
#pragma once
#include <cstddef>

namespace heliograph {

// One row of doubles, matrices row by row. The first 15 are the motion as SE_2(3) is packed: rotation, position, velocity.
struct MotionRow {
  static constexpr size_t kTimes = 15, kBias = 18, kByBias = 24, kRange = 78, kCount = 80, kEnd = 81, kModel = 82, kSize = 92;
};

constexpr size_t kSampleNumbers = 7;  // stamp from the interval's start [ns], rate, specific force

// Log(E) of E = delta(bias)^-1 seen, blocks of the inverse right Jacobian [J 0 0; C0 J 0; C1 0 J], and the derivative of the
// residual by the bias, 9 x 6.
struct MotionTerm {
  double r[9];
  double J[9];
  double C[2][9];
  double by_bias[54];
};

// The motion integrated anew at a bias outside the linear range of the row's own, with a smooth passage from the first order.
// `seen` is packed; `samples` rows were kept, of which the row says how many are used: none: the first order everywhere.
void motion_far(const double* row, const double* sampled, size_t samples, const double* bias, const double* seen, MotionTerm* out);

}  // namespace heliograph
