// SPDX-License-Identifier: MIT
// What a satellite receiver measures: the position of a point on the body, and the body's velocity.
#pragma once
#include "factors/sensor_codes.hpp"
#include "graph/factors/residuals_point.inl"

namespace heliograph {
namespace {

template <int kDof, bool kVariable>
struct LeverArmLayout {
  using type = Fixed<3, kDof>;
};
template <int kDof>
struct LeverArmLayout<kDof, true> {
  using type = Fixed<3, kDof, 3>;
};

// p + R l - z; the measurement is the lever arm l, where it is no variable, then z.
template <class P, bool kVariable>
struct LeverArmPosition {
  using Layout = typename LeverArmLayout<P::kDof, kVariable>::type;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, layout.arity(), 0), *z = measurement_of(v, k, kVariable ? 3 : 6) + (kVariable ? 0 : 3);
    const double* arm = kVariable ? value_of(v, k, layout.arity(), 1) : z - 3;
    double turned[3];
    lie::so3_rotate(x, arm, turned);
    for (int i = 0; i < 3; ++i) {
      r[i] = x[P::kPoint + i] + turned[i] - z[i];
      if constexpr (!kJacobian) continue;
      double* row = W + i * layout.stride();
      lie::cross3(arm, x + 3 * i, row);
      for (int c = 0; c < 3; ++c) row[P::kColumn + c] = x[3 * i + c];
      if constexpr (kVariable)
        for (int c = 0; c < 3; ++c) row[P::kDof + c] = x[3 * i + c];
    }
  }
};

// v - z in the world.
struct Velocity {
  using Layout = Fixed<3, 9>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, 1, 0), *z = measurement_of(v, k, 3);
    for (int i = 0; i < 3; ++i) {
      r[i] = x[12 + i] - z[i];
      if constexpr (!kJacobian) continue;
      for (int c = 0; c < 3; ++c) W[i * layout.stride() + 6 + c] = x[3 * i + c];
    }
  }
};

}  // namespace
}  // namespace heliograph
