// SPDX-License-Identifier: MIT
// Motions in space with `Vectors` translation-like vectors behind the rotation: one is SE(3), two (position, velocity)
// are SE_2(3). R row-major, then the vectors; tangent: rotation first, then the vectors.
#pragma once
#include "lie/so3.hpp"

namespace heliograph::lie {
namespace {

// A^-1 B.
template <int Vectors>
HELIOGRAPH_INLINE void motion_between(const double* A, const double* B, double* out) {
  so3_between(A, B, out);
  for (int n = 0; n < Vectors; ++n) {
    const double* a = A + 9 + 3 * n;
    const double* b = B + 9 + 3 * n;
    const double d[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
    so3_rotate_back(A, d, out + 9 + 3 * n);
  }
}

// r = Log(E).
template <int Vectors>
HELIOGRAPH_INLINE RotationLog motion_log(const double* E, double* r) {
  const RotationLog log = so3_log(E, r);
  for (int n = 0; n < Vectors; ++n) unroll3(r, log.h, E + 9 + 3 * n, r + 3 + 3 * n);
  return log;
}

// x <- x exp(d).
template <int Vectors>
static inline void motion_retract(const double* x, const double* d, double* out) {
  double R[9], left[9], moved[3 * Vectors];
  so3_retract(x, d, R, left);
  for (int n = 0; n < Vectors; ++n) {
    double step[3];
    so3_rotate(left, d + 3 + 3 * n, step);
    so3_rotate(x, step, moved + 3 * n);
  }
  for (int i = 0; i < 3 * Vectors; ++i) out[9 + i] = x[9 + i] + moved[i];
  for (int i = 0; i < 9; ++i) out[i] = R[i];
}

}  // namespace
}  // namespace heliograph::lie
