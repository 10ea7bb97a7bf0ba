// SPDX-License-Identifier: MIT
// Residuals of directions and planes of the world as a body sees them: attitude, plane, point to plane. A plane is n.x = d;
// its normal n is a direction (two angles), its distance d from the origin a vector of one number.
#pragma once
#include "graph/factors/residuals_point.inl"

namespace heliograph {
namespace {

// Row `g` by a direction of the world, at `column`: along the basis of its two angles.
HELIOGRAPH_INLINE void put_direction_row(const double* direction, const double* g, double* W, int column) {
  double first[3], second[3];
  lie::s2_basis(direction, first, second);
  W[column] = lie::dot3(first, g);
  W[column + 1] = lie::dot3(second, g);
}

// Z.local(R' d) and its derivatives by the turn of the body, at column 0, and by d, at `column` if that is not negative.
template <bool kJacobian>
HELIOGRAPH_INLINE void direction_rows(const double* R, const double* d, const double* z, int stride, int column, double* r,
                                      double* W) {
  double y[3], G[6];
  lie::so3_rotate_back(R, d, y);
  lie::s2_local(z, y, r, kJacobian ? G : nullptr);
  if constexpr (!kJacobian) return;
  for (int i = 0; i < 2; ++i) {
    lie::cross3(G + 3 * i, y, W + i * stride);
    if (column < 0) continue;
    double world[3];
    lie::so3_rotate(R, G + 3 * i, world);
    put_direction_row(d, world, W + i * stride, column);
  }
}

template <int kDof, bool kVariable>
struct AttitudeLayout {
  using type = Fixed<2, kDof>;
};
template <int kDof>
struct AttitudeLayout<kDof, true> {
  using type = Fixed<2, kDof, 2>;
};

// The measurement is the direction seen, then, where it is no variable, that of the world.
template <int kDof, bool kVariable>
struct Attitude {
  using Layout = typename AttitudeLayout<kDof, kVariable>::type;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *R = value_of(v, k, layout.arity(), 0), *z = measurement_of(v, k, kVariable ? 3 : 6);
    const double* d = kVariable ? value_of(v, k, layout.arity(), 1) : z + 3;
    direction_rows<kJacobian>(R, d, z, layout.stride(), kVariable ? kDof : -1, r, W);
  }
};

template <int kRows, int kDof, bool kVariable>
struct PlaneLayout {
  using type = Fixed<kRows, kDof>;
};
template <int kRows, int kDof>
struct PlaneLayout<kRows, kDof, true> {
  using type = Fixed<kRows, kDof, 2, 1>;
};

// [Z.local(R' n); d - n.p - z]: a pose sees the plane's normal and its own distance from it.
template <class P, bool kVariable>
struct Plane {
  using Layout = typename PlaneLayout<3, P::kDof, kVariable>::type;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, layout.arity(), 0), *z = measurement_of(v, k, kVariable ? 4 : 8);
    const double* n = kVariable ? value_of(v, k, layout.arity(), 1) : z + 4;
    const double d = kVariable ? value_of(v, k, layout.arity(), 2)[0] : z[7];
    const int stride = layout.stride();
    direction_rows<kJacobian>(x, n, z, stride, kVariable ? P::kDof : -1, r, W);
    r[2] = d - lie::dot3(n, x + P::kPoint) - z[3];
    if constexpr (!kJacobian) return;
    put_point_row<P>(x, n, W + 2 * stride, 0, -1.0);
    if constexpr (!kVariable) return;
    const double back[3] = {-x[P::kPoint], -x[P::kPoint + 1], -x[P::kPoint + 2]};
    put_direction_row(n, back, W + 2 * stride, P::kDof);
    W[2 * stride + P::kDof + 2] = 1.0;
  }
};

// n.(R q + p) - d of a point q in the frame of a pose.
template <class P, bool kVariable>
struct PointToPlane {
  using Layout = typename PlaneLayout<1, P::kDof, kVariable>::type;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, layout.arity(), 0), *q = measurement_of(v, k, kVariable ? 3 : 7);
    const double* n = kVariable ? value_of(v, k, layout.arity(), 1) : q + 3;
    const double d = kVariable ? value_of(v, k, layout.arity(), 2)[0] : q[6];
    double point[3], local[3];
    lie::so3_rotate(x, q, point);
    for (int i = 0; i < 3; ++i) point[i] += x[P::kPoint + i];
    r[0] = lie::dot3(n, point) - d;
    if constexpr (!kJacobian) return;
    lie::so3_rotate_back(x, n, local);
    lie::cross3(q, local, W);
    for (int i = 0; i < 3; ++i) W[P::kColumn + i] = local[i];
    if constexpr (!kVariable) return;
    put_direction_row(n, point, W, P::kDof);
    W[P::kDof + 2] = -1.0;
  }
};

// n.(Ti^-1 Tj q) - d: the plane lies in the frame of pose i, the point in that of pose j.
template <class I, class J>
struct PointToPlaneBetween {
  using Layout = Fixed<1, I::kDof, J::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout&, size_t k, double* r, double* W) {
    const double *xi = value_of(v, k, 2, 0), *xj = value_of(v, k, 2, 1), *q = measurement_of(v, k, 7), *n = q + 3;
    double point[3], seen[3], world[3], local[3];
    lie::so3_rotate(xj, q, point);
    for (int i = 0; i < 3; ++i) point[i] += xj[J::kPoint + i] - xi[I::kPoint + i];
    lie::so3_rotate_back(xi, point, seen);
    r[0] = lie::dot3(n, seen) - q[6];
    if constexpr (!kJacobian) return;
    lie::cross3(n, seen, W);
    for (int i = 0; i < 3; ++i) W[I::kColumn + i] = -n[i];
    lie::so3_rotate(xi, n, world);
    lie::so3_rotate_back(xj, world, local);
    lie::cross3(q, local, W + I::kDof);
    for (int i = 0; i < 3; ++i) W[I::kDof + J::kColumn + i] = local[i];
  }
};

}  // namespace
}  // namespace heliograph
