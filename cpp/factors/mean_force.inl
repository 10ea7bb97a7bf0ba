// SPDX-License-Identifier: MIT
// What an accelerometer shows on average over a long window, less the acceleration of the way: which way up is.
#pragma once
#include "factors/sensor_codes.hpp"
#include "graph/factors/residuals_point.inl"

namespace heliograph {
namespace {

// R' u + M b - z: the upward force u that holds the body against gravity, seen from the body, with the bias b of the
// accelerometer as the body's turning lets it through. The measurement is the mean force z, then M by rows.
template <class P>
struct MeanForce {
  using Layout = Fixed<3, P::kDof, 3, 3>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, 3, 0), *up = value_of(v, k, 3, 1), *bias = value_of(v, k, 3, 2);
    const double *z = measurement_of(v, k, 12), *M = z + 3;
    double seen[3];
    lie::so3_rotate_back(x, up, seen);
    for (int i = 0; i < 3; ++i) {
      r[i] = seen[i] - z[i];
      for (int c = 0; c < 3; ++c) r[i] += M[3 * i + c] * bias[c];
      if constexpr (!kJacobian) continue;
      double *row = W + i * layout.stride(), axis[3] = {0.0, 0.0, 0.0};
      axis[i] = 1.0;
      lie::cross3(axis, seen, row);
      for (int c = 0; c < 3; ++c) {
        row[P::kDof + c] = x[3 * c + i];
        row[P::kDof + 3 + c] = M[3 * i + c];
      }
    }
  }
};

}  // namespace
}  // namespace heliograph
