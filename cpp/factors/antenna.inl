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

template <int kDof, bool kVariable>
struct AnchoredLayout {
  using type = Fixed<3, kDof, 6>;
};
template <int kDof>
struct AnchoredLayout<kDof, true> {
  using type = Fixed<3, kDof, 6, 3>;
};

// Re' (p + R (o + l) - te) - z: a point on the body seen from a frame that is a variable, such as east-north-up. The
// measurement is the offset o, then z; the lever arm l is a variable, or nothing.
template <class P, bool kVariable>
struct AnchoredPosition {
  using Layout = typename AnchoredLayout<P::kDof, kVariable>::type;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, layout.arity(), 0), *frame = value_of(v, k, layout.arity(), 1);
    const double* z = measurement_of(v, k, 6);
    double arm[3] = {z[0], z[1], z[2]}, turned[3], q[3];
    if constexpr (kVariable)
      for (int i = 0; i < 3; ++i) arm[i] += value_of(v, k, layout.arity(), 2)[i];
    lie::so3_rotate(x, arm, turned);
    for (int i = 0; i < 3; ++i) turned[i] += x[P::kPoint + i] - frame[9 + i];
    lie::so3_rotate_back(frame, turned, q);
    double M[9];  // Re' R
    if constexpr (kJacobian)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          M[3 * i + j] = frame[i] * x[j] + frame[3 + i] * x[3 + j] + frame[6 + i] * x[6 + j];
    for (int i = 0; i < 3; ++i) {
      r[i] = q[i] - z[3 + i];
      if constexpr (!kJacobian) continue;
      double *row = W + i * layout.stride(), axis[3] = {0.0, 0.0, 0.0};
      axis[i] = 1.0;
      lie::cross3(arm, M + 3 * i, row);
      lie::cross3(axis, q, row + P::kDof);
      row[P::kDof + 3 + i] = -1.0;
      for (int c = 0; c < 3; ++c) row[P::kColumn + c] = M[3 * i + c];
      if constexpr (kVariable)
        for (int c = 0; c < 3; ++c) row[P::kDof + 6 + c] = M[3 * i + c];
    }
  }
};

// Ri' (pj - pi + Rj l) - l - k d: the body's way between two instants by wheels or legs, whose scale k is a variable. The
// measurement is the lever arm l, then the displacement d, in the body's axes at i.
template <class P>
struct ScaledMotion {
  using Layout = Fixed<3, P::kDof, P::kDof, 1>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *xi = value_of(v, k, 3, 0), *xj = value_of(v, k, 3, 1), scale = value_of(v, k, 3, 2)[0];
    const double *arm = measurement_of(v, k, 6), *d = arm + 3;
    double world[3], q[3];
    lie::so3_rotate(xj, arm, world);
    for (int i = 0; i < 3; ++i) world[i] += xj[P::kPoint + i] - xi[P::kPoint + i];
    lie::so3_rotate_back(xi, world, q);
    for (int i = 0; i < 3; ++i) {
      r[i] = q[i] - arm[i] - scale * d[i];
      if constexpr (!kJacobian) continue;
      double *row = W + i * layout.stride(), axis[3] = {0.0, 0.0, 0.0}, M[3];
      axis[i] = 1.0;
      for (int c = 0; c < 3; ++c) M[c] = xi[i] * xj[c] + xi[3 + i] * xj[3 + c] + xi[6 + i] * xj[6 + c];
      lie::cross3(axis, q, row);
      row[P::kColumn + i] = -1.0;
      lie::cross3(arm, M, row + P::kDof);
      for (int c = 0; c < 3; ++c) row[P::kDof + P::kColumn + c] = M[c];
      row[2 * P::kDof] = -d[i];
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
