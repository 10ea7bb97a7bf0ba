// SPDX-License-Identifier: MIT
// Residuals between a pose or point and a point of another variable: range, bearing, landmark, position.
#pragma once
#include "graph/factors/residuals_pose.inl"

namespace heliograph {
namespace {

// Where a family keeps its point. A turn of a pose does not move its own point; its translation moves it along R.

template <int kSpaceOf, int kDofOf, int kColumnOf, int kPointOf, bool kPoseOf>
struct PointLayout {
  static constexpr int kSpace = kSpaceOf, kDof = kDofOf;
  static constexpr int kColumn = kColumnOf;  // of the translation in the tangent
  static constexpr int kPoint = kPointOf;    // offset in the value
  static constexpr bool kPose = kPoseOf;
};

struct Point2 : PointLayout<2, 2, 0, 0, false> {};
struct Point3 : PointLayout<3, 3, 0, 0, false> {};
struct PoseSe2 : PointLayout<2, 3, 1, 2, true> {};
struct PoseSe3 : PointLayout<3, 6, 3, 9, true> {};
struct PoseNav : PointLayout<3, 9, 3, 9, true> {};

// out = R' v in the frame of a pose.
template <int kSpace>
HELIOGRAPH_INLINE void into_frame(const double* pose, const double* v, double* out) {
  if constexpr (kSpace == 2) lie::so2_rotate_back(pose, v, out);
  if constexpr (kSpace == 3) lie::so3_rotate_back(pose, v, out);
}

// Row `g` by the world point of part P, into W at `column`: g R for a pose, g for a point.
template <class P>
HELIOGRAPH_INLINE void put_point_row(const double* x, const double* g, double* W, int column, double sign) {
  double local[3] = {g[0], g[1], P::kSpace == 3 ? g[2] : 0.0};
  if constexpr (P::kPose) into_frame<P::kSpace>(x, g, local);
  for (int i = 0; i < P::kSpace; ++i) W[column + P::kColumn + i] = sign * local[i];
}

// World coordinates of a row in the frame of a pose: g R'.
template <int kSpace>
HELIOGRAPH_INLINE void out_of_frame(const double* pose, const double* g, double* out) {
  if constexpr (kSpace == 2) lie::so2_rotate(pose, g, out);
  if constexpr (kSpace == 3) lie::so3_rotate(pose, g, out);
}

// |p_j - p_i| - z; where the points coincide there is no direction, and the Jacobian is zero.
template <class I, class J, bool kJacobian>
HELIOGRAPH_INLINE void range_row(const double* xi, const double* xj, double z, double* r, double* W) {
  double d[3], length2 = 0.0;
  for (int i = 0; i < I::kSpace; ++i) {
    d[i] = xj[J::kPoint + i] - xi[I::kPoint + i];
    length2 += d[i] * d[i];
  }
  const double length = std::sqrt(length2);
  r[0] = length - z;
  if constexpr (!kJacobian) return;
  const double scale = length > 0.0 ? 1.0 / length : 0.0;
  for (int i = 0; i < I::kSpace; ++i) d[i] *= scale;
  put_point_row<I>(xi, d, W, 0, -1.0);
  put_point_row<J>(xj, d, W, I::kDof, 1.0);
}

template <class I, class J>
struct Range {
  using Layout = Fixed<1, I::kDof, J::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout&, size_t k, double* r, double* W) {
    range_row<I, J, kJacobian>(value_of(v, k, 2, 0), value_of(v, k, 2, 1), measurement_of(v, k, 1)[0], r, W);
  }
};

// The point of j seen from pose i: q = Ri' (p_j - p_i).
template <class I, class J>
HELIOGRAPH_INLINE void seen_from(const double* xi, const double* xj, double* q) {
  double d[3];
  for (int i = 0; i < I::kSpace; ++i) d[i] = xj[J::kPoint + i] - xi[I::kPoint + i];
  into_frame<I::kSpace>(xi, d, q);
}

// A row g dq into the columns of both: dq = q x theta - dt_i + Ri' dp_j.
template <class I, class J>
HELIOGRAPH_INLINE void put_seen_row(const double* xi, const double* xj, const double* q, const double* g, double* W) {
  if constexpr (I::kSpace == 2) W[0] = g[0] * q[1] - g[1] * q[0];
  if constexpr (I::kSpace == 3) lie::cross3(g, q, W);
  for (int i = 0; i < I::kSpace; ++i) W[I::kColumn + i] = -g[i];
  double world[3];
  out_of_frame<I::kSpace>(xi, g, world);
  put_point_row<J>(xj, world, W, I::kDof, 1.0);
}

template <class I, class J>
struct Landmark {
  using Layout = Fixed<I::kSpace, I::kDof, J::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *xi = value_of(v, k, 2, 0), *xj = value_of(v, k, 2, 1), *z = measurement_of(v, k, I::kSpace);
    double q[3];
    seen_from<I, J>(xi, xj, q);
    for (int i = 0; i < I::kSpace; ++i) {
      r[i] = q[i] - z[i];
      const double g[3] = {i == 0 ? 1.0 : 0.0, i == 1 ? 1.0 : 0.0, i == 2 ? 1.0 : 0.0};
      if constexpr (kJacobian) put_seen_row<I, J>(xi, xj, q, g, W + i * layout.stride());
    }
  }
};

// In the plane an angle, in space Z.local(direction). A point at the pose itself has no direction: it says nothing.
template <class I, class J, bool kJacobian>
HELIOGRAPH_INLINE void bearing_rows(const double* xi, const double* xj, const double* z, int stride, double* r, double* W) {
  double q[3] = {0.0, 0.0, 0.0};
  seen_from<I, J>(xi, xj, q);
  const double length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2], inverse2 = length2 > 0.0 ? 1.0 / length2 : 0.0;
  if constexpr (I::kSpace == 2) {
    double E[2];
    lie::so2_between(z, q, E);
    r[0] = std::atan2(E[1], E[0]);
    const double g[2] = {-q[1] * inverse2, q[0] * inverse2};
    if constexpr (kJacobian) put_seen_row<I, J>(xi, xj, q, g, W);
    return;
  }
  if constexpr (I::kSpace == 3) {
    const double inverse = std::sqrt(inverse2), y[3] = {inverse * q[0], inverse * q[1], inverse * q[2]};
    double G[6];
    lie::s2_local(z, y, r, kJacobian ? G : nullptr);
    if constexpr (!kJacobian) return;
    for (int i = 0; i < 2; ++i) {
      const double along = lie::dot3(G + 3 * i, y);
      double g[3];
      for (int n = 0; n < 3; ++n) g[n] = inverse * (G[3 * i + n] - along * y[n]);
      put_seen_row<I, J>(xi, xj, q, g, W + i * stride);
    }
  }
}

template <class I, class J>
struct Bearing {
  using Layout = Fixed<I::kSpace - 1, I::kDof, J::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double* z = measurement_of(v, k, I::kSpace);
    bearing_rows<I, J, kJacobian>(value_of(v, k, 2, 0), value_of(v, k, 2, 1), z, layout.stride(), r, W);
  }
};

template <class I, class J>
struct BearingRange {
  static constexpr int kAngles = I::kSpace - 1;
  using Layout = Fixed<I::kSpace, I::kDof, J::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *xi = value_of(v, k, 2, 0), *xj = value_of(v, k, 2, 1), *z = measurement_of(v, k, I::kSpace + 1);
    bearing_rows<I, J, kJacobian>(xi, xj, z, layout.stride(), r, W);
    range_row<I, J, kJacobian>(xi, xj, z[I::kSpace], r + kAngles, kJacobian ? W + kAngles * layout.stride() : nullptr);
  }
};

// p - z in the world.
template <class P>
struct Position {
  using Layout = Fixed<P::kSpace, P::kDof>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, 1, 0), *z = measurement_of(v, k, P::kSpace);
    for (int i = 0; i < P::kSpace; ++i) {
      r[i] = x[P::kPoint + i] - z[i];
      const double g[3] = {i == 0 ? 1.0 : 0.0, i == 1 ? 1.0 : 0.0, i == 2 ? 1.0 : 0.0};
      if constexpr (kJacobian) put_point_row<P>(x, g, W + i * layout.stride(), 0, 1.0);
    }
  }
};

}  // namespace
}  // namespace heliograph
