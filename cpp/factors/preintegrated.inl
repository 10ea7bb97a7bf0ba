// SPDX-License-Identifier: MIT
// Preintegrated motions between extended poses: Log(delta(b)^-1 . (Xi^-1 Xj without gravity)), and with walking biases their
// change. Inside the linear range of the bias the motion answers to first order; motion_far() has the rest.
#pragma once
#include "factors/sensor_codes.hpp"
#include "graph/factors/residuals_pose.inl"
#include "imu/motion_row.hpp"

namespace heliograph {
namespace {

constexpr double kFarTurn2 = 9.0;  // squared angle of a correction beyond which the series of a logarithm do not reach

// h and its derivative by the squared angle s, as a logarithm has them.
HELIOGRAPH_INLINE lie::RotationLog log_terms(double s) {
  constexpr double kNear = 0.61685027506808491;  // (pi / 4)^2
  if (s <= kNear) return {lie::half_cotangent_defect_near(s), lie::half_cotangent_slope_near(s)};
  const double half = 0.5 * std::sqrt(s), h = (1.0 - half / std::tan(half)) / s;
  return {h, lie::half_cotangent_slope_far(s, h)};
}

// out = Ad(X^-1) d for one column of perturbations, three parts of `step` doubles each; out may be d.
HELIOGRAPH_INLINE void to_right(const double* X, const double* d, double* out) {
  double crossed[3], part[3];
  for (int n = 2; n >= 1; --n) {
    lie::cross3(X + 6 + 3 * n, d, crossed);
    for (int i = 0; i < 3; ++i) part[i] = d[3 * n + i] - crossed[i];
    lie::so3_rotate_back(X, part, out + 3 * n);
  }
  lie::so3_rotate_back(X, d, out);
}

// out = [A 0 0; B0 A 0; B1 0 A] d; out may be d.
HELIOGRAPH_INLINE void times_blocks(const double* A, const double (*B)[9], const double* d, double* out) {
  double turned[3], part[3];
  for (int n = 2; n >= 1; --n) {
    lie::so3_rotate(B[n - 1], d, turned);
    lie::so3_rotate(A, d + 3 * n, part);
    for (int i = 0; i < 3; ++i) out[3 * n + i] = turned[i] + part[i];
  }
  lie::so3_rotate(A, d, out);
}

// The motion corrected to first order: delta exp(step), step = by_bias change. `left` receives what exp does to vectors.
HELIOGRAPH_INLINE void correct(const double* row, const double* step, double* expected, double* left) {
  const lie::ExpTerms e = lie::exp_terms(lie::dot3(step, step));
  double turn[9], moved[3], world[3];
  lie::quadratic3(step, e.sinc, e.versine, turn);
  lie::quadratic3(step, e.versine, e.cubic, left);
  lie::multiply3(row, turn, expected);
  for (int n = 1; n <= 2; ++n) {
    lie::so3_rotate(left, step + 3 * n, moved);
    lie::so3_rotate(row, moved, world);
    for (int i = 0; i < 3; ++i) expected[6 + 3 * n + i] = row[6 + 3 * n + i] + world[i];
  }
}

// Blocks A, B0, B1 of the right Jacobian of exp at the step, from those of its inverse: B = -A C A.
HELIOGRAPH_INLINE void right_jacobian_blocks(const double* step, const double* left, double* A, double (*B)[9]) {
  const double s = lie::dot3(step, step);
  const lie::RotationLog log = log_terms(s);
  const lie::ExpTerms e = lie::exp_terms(s);
  double J[9], C[9], CA[9], vector[3];
  lie::quadratic3(step, -e.versine, e.cubic, A);
  lie::so3_right_jacobian_inverse(step, log.h, J);
  for (int n = 1; n <= 2; ++n) {
    lie::so3_rotate(left, step + 3 * n, vector);
    lie::unroll3_jacobian(step, log, vector, J, C);
    lie::multiply3(C, A, CA);
    lie::multiply3(A, CA, B[n - 1]);
    for (int i = 0; i < 9; ++i) B[n - 1][i] = -B[n - 1][i];
  }
}

template <bool kJacobian>
HELIOGRAPH_INLINE void compare_first_order(const double* row, const double* step, const double* seen, MotionTerm* out) {
  double expected[15], left[9], E[15];
  correct(row, step, expected, left);
  lie::motion_between<2>(expected, seen, E);
  const lie::RotationLog log = lie::motion_log<2>(E, out->r);
  if constexpr (!kJacobian) return;
  lie::so3_right_jacobian_inverse(out->r, log.h, out->J);
  for (int n = 1; n <= 2; ++n) lie::unroll3_jacobian(out->r, log, E + 6 + 3 * n, out->J, out->C[n - 1]);
  double A[9], B[2][9];
  right_jacobian_blocks(step, left, A, B);
  for (int c = 0; c < 6; ++c) {
    double column[9];
    for (int i = 0; i < 9; ++i) column[i] = row[MotionRow::kByBias + static_cast<size_t>(6 * i + c)];
    times_blocks(A, B, column, column);
    to_right(E, column, column);
    times_blocks(out->J, out->C, column, column);
    for (int i = 0; i < 9; ++i) out->by_bias[6 * i + c] = -column[i];
  }
}

// What the row expects of the motion `seen` at a bias.
template <bool kJacobian>
HELIOGRAPH_INLINE void compare_motion(const double* row, const double* sampled, size_t samples, const double* bias,
                                      const double* seen, MotionTerm* out) {
  double change[6], step[9];
  for (size_t i = 0; i < 6; ++i) change[i] = bias[i] - row[MotionRow::kBias + i];
  for (size_t i = 0; i < 9; ++i) {
    step[i] = 0.0;
    for (size_t c = 0; c < 6; ++c) step[i] += row[MotionRow::kByBias + 6 * i + c] * change[c];
  }
  const double* range = row + MotionRow::kRange;
  const double gyro2 = lie::dot3(change, change), both = std::sqrt(gyro2 * lie::dot3(change + 3, change + 3));
  const bool linear = samples == 0 || range[0] * gyro2 + range[1] * both <= 1.0;
  if (!linear || !(lie::dot3(step, step) <= kFarTurn2)) return motion_far(row, sampled, samples, bias, seen, out);
  compare_first_order<kJacobian>(row, step, seen, out);
}

// Rows and degrees of freedom; gravity has none where it is known.
template <bool kWalk, int kGravity>
struct MotionLayout {
  using type = Fixed<9, 9, 9, 6, kGravity>;
};
template <int kGravity>
struct MotionLayout<true, kGravity> {
  using type = Fixed<15, 9, 6, 9, 6, kGravity>;
};
template <>
struct MotionLayout<false, 0> {
  using type = Fixed<9, 9, 9, 6>;
};
template <>
struct MotionLayout<true, 0> {
  using type = Fixed<15, 9, 6, 9, 6>;
};

// Variables: Xi, Xj, bias, or with the walk of the bias Xi, bias_i, Xj, bias_j; then gravity, if it is one: a direction or a
// vector. The measurement is the row, known gravity or its magnitude, and the samples.
template <bool kWalk, int kGravity>
struct PreintegratedMotion {
  using Layout = typename MotionLayout<kWalk, kGravity>::type;
  static constexpr int kBias = kWalk ? 1 : 2, kJ = kWalk ? 2 : 1, kDown = kWalk ? 4 : 3;
  static constexpr size_t kSamples = MotionRow::kSize + gravity_numbers(kGravity != 0);

  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *row = measurement_of(v, k, v.measurement_size), *xj = value_of(v, k, layout.arity(), kJ);
    double down[3], start[15], seen[15];
    gravity(v, layout, k, row + MotionRow::kSize, down);
    begin(value_of(v, k, layout.arity(), 0), row + MotionRow::kTimes, down, start);
    lie::motion_between<2>(start, xj, seen);
    MotionTerm term;
    const size_t samples = (static_cast<size_t>(v.measurement_size) - kSamples) / kSampleNumbers;
    compare_motion<kJacobian>(row, row + kSamples, samples, value_of(v, k, layout.arity(), kBias), seen, &term);
    for (int i = 0; i < 9; ++i) r[i] = term.r[i];
    if constexpr (kWalk) {
      const double *bias_i = value_of(v, k, layout.arity(), 1), *bias_j = value_of(v, k, layout.arity(), 3);
      for (int i = 0; i < 6; ++i) r[9 + i] = bias_j[i] - bias_i[i];
    }
    if constexpr (kJacobian) jacobians(v, layout, k, row, seen, term, W);
  }

  HELIOGRAPH_INLINE void gravity(const FactorView& v, const Layout& layout, size_t k, const double* known, double* down) {
    const double* g = kGravity == 0 ? known : value_of(v, k, layout.arity(), kDown);
    const double scale = kGravity == 2 ? known[0] : 1.0;
    for (int i = 0; i < 3; ++i) down[i] = scale * g[i];
  }

  // The first pose carried along by its velocity and gravity.
  HELIOGRAPH_INLINE void begin(const double* xi, const double* times, const double* down, double* start) {
    for (int i = 0; i < 9; ++i) start[i] = xi[i];
    for (int i = 0; i < 3; ++i) {
      start[9 + i] = xi[9 + i] + times[0] * xi[12 + i] + times[2] * down[i];
      start[12 + i] = xi[12 + i] + times[1] * down[i];
    }
  }

  HELIOGRAPH_INLINE void jacobians(const FactorView& v, const Layout& layout, size_t k, const double* row, const double* seen,
                                   const MotionTerm& term, double* W) {
    const int stride = layout.stride(), j = layout.column(kJ), bias = layout.column(kBias);
    const double* times = row + MotionRow::kTimes;
    double JR[9];
    lie::multiply3_transposed(term.J, seen, JR);
    put3(W, stride, 0, 0, JR, -1.0);
    put3(W, stride, 0, j, term.J);
    for (int n = 1; n <= 2; ++n) put_ends(seen, term.J, JR, term.C[n - 1], n, stride, 0, j, W);
    for (int i = 0; i < 3; ++i)  // the velocity at the start moves the position
      for (int c = 0; c < 3; ++c) W[(3 + i) * stride + 6 + c] += times[0] * W[(3 + i) * stride + 3 + c];
    for (int i = 0; i < 9; ++i)
      for (int c = 0; c < 6; ++c) W[i * stride + bias + c] = term.by_bias[6 * i + c];
    if constexpr (kWalk) {
      for (int i = 0; i < 6; ++i) {
        W[(9 + i) * stride + bias + i] = -1.0;
        W[(9 + i) * stride + layout.column(3) + i] = 1.0;
      }
    }
    if constexpr (kGravity != 0) by_gravity(v, layout, k, row, term, W);
  }

  HELIOGRAPH_INLINE void by_gravity(const FactorView& v, const Layout& layout, size_t k, const double* row, const MotionTerm& term,
                                    double* W) {
    const double *xj = value_of(v, k, layout.arity(), kJ), *times = row + MotionRow::kTimes;
    const int stride = layout.stride(), down = layout.column(kDown);
    double back[9], first[3], second[3];
    lie::multiply3_transposed(term.J, xj, back);
    if constexpr (kGravity == 2) lie::s2_basis(value_of(v, k, layout.arity(), kDown), first, second);
    for (int n = 1; n <= 2; ++n) {
      const double scale = -(n == 1 ? times[2] : times[1]) * (kGravity == 2 ? row[MotionRow::kSize] : 1.0);
      for (int i = 0; i < 3; ++i) {
        double* out = W + (3 * n + i) * stride + down;
        if constexpr (kGravity == 2) {
          out[0] = scale * lie::dot3(back + 3 * i, first);
          out[1] = scale * lie::dot3(back + 3 * i, second);
        } else {
          for (int c = 0; c < 3; ++c) out[c] = scale * back[3 * i + c];
        }
      }
    }
  }
};

}  // namespace
}  // namespace heliograph
