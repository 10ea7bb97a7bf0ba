// SPDX-License-Identifier: MIT
// Residuals of the whole value: prior Log(Z^-1 X) and between Log(Z^-1 Xi^-1 Xj). With E the argument of the logarithm and
// Jr its right Jacobian: J_j = Jr^-1, J_i = -Jr^-1 Ad((Xi^-1 Xj)^-1).
#pragma once
#include "graph/factors/actions.inl"
#include "lie/s2.hpp"
#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace heliograph {
namespace {

HELIOGRAPH_INLINE const double* value_of(const FactorView& v, size_t k, int arity, int a) {
  return v.x + v.values[k * static_cast<size_t>(arity) + static_cast<size_t>(a)];
}

HELIOGRAPH_INLINE const double* measurement_of(const FactorView& v, size_t k, int size) {
  return v.measurement + k * static_cast<size_t>(size);
}

HELIOGRAPH_INLINE void put3(double* W, int stride, int row, int column, const double* M, double sign = 1.0) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) W[(row + i) * stride + column + j] = sign * M[3 * i + j];
}

struct PriorSo2 {
  using Layout = Fixed<1, 1>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout&, size_t k, double* r, double* W) {
    double E[2];
    lie::so2_between(measurement_of(v, k, v.measurement_size), value_of(v, k, 1, 0), E);
    r[0] = lie::so2_log(E[0], E[1]).angle;
    if constexpr (kJacobian) W[0] = 1.0;
  }
};

struct BetweenSo2 {
  using Layout = Fixed<1, 1, 1>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout&, size_t k, double* r, double* W) {
    double D[2], E[2];
    lie::so2_between(value_of(v, k, 2, 0), value_of(v, k, 2, 1), D);
    lie::so2_between(measurement_of(v, k, 2), D, E);
    r[0] = lie::so2_log(E[0], E[1]).angle;
    if constexpr (kJacobian) W[0] = -1.0, W[1] = 1.0;
  }
};

// Jr^-1 of SE(2) in columns of W.
HELIOGRAPH_INLINE void put_se2(double* W, int stride, int column, const lie::Se2Jacobian& J) {
  double* row = W + column;
  row[0] = 1.0;
  row[stride] = J.w[0];
  row[stride + 1] = J.g;
  row[stride + 2] = -J.q;
  row[2 * stride] = J.w[1];
  row[2 * stride + 1] = J.q;
  row[2 * stride + 2] = J.g;
}

struct PriorSe2 {
  using Layout = Fixed<3, 3>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    double E[4];
    lie::se2_between(measurement_of(v, k, v.measurement_size), value_of(v, k, 1, 0), E);
    const lie::Se2Jacobian J = lie::se2_log(E, r);
    if constexpr (kJacobian) put_se2(W, layout.stride(), 0, J);
  }
};

struct BetweenSe2 {
  using Layout = Fixed<3, 3, 3>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    double D[4], E[4];
    lie::se2_between(value_of(v, k, 2, 0), value_of(v, k, 2, 1), D);
    lie::se2_between(measurement_of(v, k, 4), D, E);
    const lie::Se2Jacobian J = lie::se2_log(E, r);
    if constexpr (kJacobian) {
      // Ad of the inverse of D = (c, s, t): [1 0; a R'], a = (s x - c y, c x + s y).
      const double a[2] = {D[1] * D[2] - D[0] * D[3], D[0] * D[2] + D[1] * D[3]};
      const double g = J.g * D[0] + J.q * D[1], q = J.q * D[0] - J.g * D[1];
      put_se2(W, layout.stride(), 0, {{J.w[0] + J.g * a[0] - J.q * a[1], J.w[1] + J.q * a[0] + J.g * a[1]}, g, q});
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) W[i * layout.stride() + j] = -W[i * layout.stride() + j];
      put_se2(W, layout.stride(), 3, J);
    }
  }
};

// Motions with n vectors behind the rotation: SO(3) has none, SE(3) one, SE_2(3) two. A measurement may be of the leading
// parts alone: then the first numbers of value and tangent are all that it looks at.
template <int kMeasured, int kVectors>
struct PriorMotion {
  using Layout = Fixed<3 + 3 * kMeasured, 3 + 3 * kVectors>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    double E[9 + 3 * kMeasured], J[9], C[9];
    lie::motion_between<kMeasured>(measurement_of(v, k, v.measurement_size), value_of(v, k, 1, 0), E);
    const lie::RotationLog log = lie::motion_log<kMeasured>(E, r);
    if constexpr (!kJacobian) return;
    lie::so3_right_jacobian_inverse(r, log.h, J);
    put3(W, layout.stride(), 0, 0, J);
    for (int n = 1; n <= kMeasured; ++n) {
      lie::unroll3_jacobian(r, log, E + 6 + 3 * n, J, C);
      put3(W, layout.stride(), 3 * n, 0, C);
      put3(W, layout.stride(), 3 * n, 3 * n, J);
    }
  }
};

// By both ends of D = Xi^-1 Xj, with Jr^-1 = [J 0; C J]: Ad of the inverse of D = (R, t) is [R' 0; -R' hat(t) R'], so that
// J_i = -[J R' 0; C R' - J R' hat(t)  J R'] and J_j = [J 0; C J]. `n` counts the vectors; C and t belong to one of them.
HELIOGRAPH_INLINE void put_ends(const double* D, const double* J, const double* JR, const double* C, int n, int stride, int i, int j,
                                double* W) {
  double CR[9], turned[9];
  lie::multiply3_transposed(C, D, CR);
  lie::multiply3_hat(JR, D + 6 + 3 * n, turned);
  for (int k = 0; k < 9; ++k) turned[k] -= CR[k];
  put3(W, stride, 3 * n, i, turned);
  put3(W, stride, 3 * n, i + 3 * n, JR, -1.0);
  put3(W, stride, 3 * n, j, C);
  put3(W, stride, 3 * n, j + 3 * n, J);
}

template <int kMeasured, int kI, int kJ>
struct BetweenMotion {
  static constexpr int kDofI = 3 + 3 * kI;
  using Layout = Fixed<3 + 3 * kMeasured, kDofI, 3 + 3 * kJ>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    double D[9 + 3 * kMeasured], E[9 + 3 * kMeasured];
    lie::motion_between<kMeasured>(value_of(v, k, 2, 0), value_of(v, k, 2, 1), D);
    lie::motion_between<kMeasured>(measurement_of(v, k, 9 + 3 * kMeasured), D, E);
    const lie::RotationLog log = lie::motion_log<kMeasured>(E, r);
    if constexpr (kJacobian) jacobians(D, E, r, log, layout.stride(), W);
  }

  HELIOGRAPH_INLINE void jacobians(const double* D, const double* E, const double* r, const lie::RotationLog& log, int stride,
                                   double* W) {
    double J[9], JR[9];
    lie::so3_right_jacobian_inverse(r, log.h, J);
    lie::multiply3_transposed(J, D, JR);
    put3(W, stride, 0, 0, JR, -1.0);
    put3(W, stride, 0, kDofI, J);
    for (int n = 1; n <= kMeasured; ++n) {
      double C[9];
      lie::unroll3_jacobian(r, log, E + 6 + 3 * n, J, C);
      put_ends(D, J, JR, C, n, stride, 0, kDofI, W);
    }
  }
};

// Z.local(X) on the sphere.
struct PriorS2 {
  using Layout = Fixed<2, 2>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double* x = value_of(v, k, 1, 0);
    if constexpr (!kJacobian) {
      lie::s2_local(measurement_of(v, k, v.measurement_size), x, r, nullptr);
      return;
    }
    double G[6], first[3], second[3];
    lie::s2_local(measurement_of(v, k, v.measurement_size), x, r, G);
    lie::s2_basis(x, first, second);
    for (int i = 0; i < 2; ++i) {
      W[i * layout.stride()] = lie::dot3(G + 3 * i, first);
      W[i * layout.stride() + 1] = lie::dot3(G + 3 * i, second);
    }
  }
};

// Vectors of any length; the frequent ones have a layout of fixed size.
template <class LayoutOf>
struct PriorVector {
  using Layout = LayoutOf;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *x = value_of(v, k, 1, 0), *z = measurement_of(v, k, v.measurement_size);
    for (int i = 0; i < layout.dof(0); ++i) {
      r[i] = x[i] - z[i];
      if constexpr (kJacobian) W[i * layout.stride() + i] = 1.0;
    }
  }
};

template <class LayoutOf>
struct BetweenVector {
  using Layout = LayoutOf;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *xi = value_of(v, k, 2, 0), *xj = value_of(v, k, 2, 1), *z = measurement_of(v, k, layout.rows());
    for (int i = 0; i < layout.rows(); ++i) {
      r[i] = xj[i] - xi[i] - z[i];
      if constexpr (kJacobian) {
        W[i * layout.stride() + i] = -1.0;
        W[i * layout.stride() + layout.rows() + i] = 1.0;
      }
    }
  }
};

// x_j - F x_i - u; the measurement is F row-major, then u.
template <class LayoutOf>
struct LinearMotionVector {
  using Layout = LayoutOf;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const int n = layout.dof(0), m = layout.rows();
    const double *xi = value_of(v, k, 2, 0), *xj = value_of(v, k, 2, 1), *F = measurement_of(v, k, m * n + m), *u = F + m * n;
    for (int i = 0; i < m; ++i) {
      double sum = xj[i] - u[i];
      for (int j = 0; j < n; ++j) sum -= F[i * n + j] * xi[j];
      r[i] = sum;
      if constexpr (!kJacobian) continue;
      for (int j = 0; j < n; ++j) W[i * layout.stride() + j] = -F[i * n + j];
      W[i * layout.stride() + n + i] = 1.0;
    }
  }
};

// Chosen rows of a prior; their numbers follow the measured value.
template <class Prior>
struct RowsOf {
  using Layout = Dynamic;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const typename Prior::Layout all(v);
    double whole[kMaxDof], J[kMaxDof * row_stride(kMaxDof)];
    if constexpr (kJacobian) clear(J, layout.dof(0) * all.stride());
    Prior::template evaluate<kJacobian>(v, all, k, whole, J);
    const double* chosen = measurement_of(v, k + 1, v.measurement_size) - layout.rows();
    for (int i = 0; i < layout.rows(); ++i) {
      const int row = static_cast<int>(chosen[i]);
      const bool known = row >= 0 && row < layout.dof(0);  // whatever damaged data hold
      r[i] = known ? whole[row] : 0.0;
      if (!kJacobian || !known) continue;
      for (int q = 0; q < layout.dof(0); ++q) W[i * layout.stride() + q] = J[row * all.stride() + q];
    }
  }
};

// What the caller has evaluated.
template <class LayoutOf>
struct Custom {
  using Layout = LayoutOf;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const int m = layout.rows();
    for (int i = 0; i < m; ++i) r[i] = v.residual[k * static_cast<size_t>(m) + static_cast<size_t>(i)];
    if constexpr (!kJacobian) return;
    for (int a = 0; a < layout.arity(); ++a) {
      const int n = layout.dof(a);
      const double* J = v.jacobian[a] + k * static_cast<size_t>(m * n);
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < n; ++j) W[i * layout.stride() + layout.column(a) + j] = J[i * n + j];
    }
  }
};

}  // namespace
}  // namespace heliograph
