// SPDX-License-Identifier: MIT
// Rotations in space as row-major 3x3 matrices; tangent: the rotation vector.
#pragma once
#include "lie/series.hpp"

namespace heliograph::lie {
namespace {

HELIOGRAPH_INLINE double dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

HELIOGRAPH_INLINE void cross3(const double* a, const double* b, double* out) {
  const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
  out[0] = x;
  out[1] = y;
  out[2] = z;
}

// C = A B; C is neither A nor B.
HELIOGRAPH_INLINE void multiply3(const double* A, const double* B, double* C) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

// C = A^T B.
HELIOGRAPH_INLINE void so3_between(const double* A, const double* B, double* C) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
}

// C = A B^T.
HELIOGRAPH_INLINE void multiply3_transposed(const double* A, const double* B, double* C) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C[3 * i + j] = dot3(A + 3 * i, B + 3 * j);
}

HELIOGRAPH_INLINE void so3_rotate(const double* R, const double* v, double* out) {
  const double x = dot3(R, v), y = dot3(R + 3, v), z = dot3(R + 6, v);
  out[0] = x;
  out[1] = y;
  out[2] = z;
}

HELIOGRAPH_INLINE void so3_rotate_back(const double* R, const double* v, double* out) {
  const double x = R[0] * v[0] + R[3] * v[1] + R[6] * v[2], y = R[1] * v[0] + R[4] * v[1] + R[7] * v[2],
               z = R[2] * v[0] + R[5] * v[1] + R[8] * v[2];
  out[0] = x;
  out[1] = y;
  out[2] = z;
}

// M hat(v): its rows are crossed with v.
HELIOGRAPH_INLINE void multiply3_hat(const double* M, const double* v, double* out) {
  for (int i = 0; i < 3; ++i) cross3(M + 3 * i, v, out + 3 * i);
}

// I + p K + q K^2 with K = hat(v): the form of exp and of the Jacobians.
HELIOGRAPH_INLINE void quadratic3(const double* v, double p, double q, double* M) {
  const double x = v[0], y = v[1], z = v[2];
  const double xy = q * x * y, xz = q * x * z, yz = q * y * z;
  M[0] = 1.0 - q * (y * y + z * z);
  M[1] = xy - p * z;
  M[2] = xz + p * y;
  M[3] = xy + p * z;
  M[4] = 1.0 - q * (x * x + z * z);
  M[5] = yz - p * x;
  M[6] = xz - p * y;
  M[7] = yz + p * x;
  M[8] = 1.0 - q * (x * x + y * y);
}

// What the inverse Jacobians at a rotation vector need: h and its derivative by the squared angle.
struct RotationLog {
  double h, slope;
};

// Unit quaternion (x, y, z, w) with w >= 0 by the largest of its components (Shepperd 1978).
static inline void so3_quaternion(const double* R, double* q) {
  const double trace = R[0] + R[4] + R[8];
  if (trace >= R[0] && trace >= R[4] && trace >= R[8]) {
    q[0] = R[7] - R[5];
    q[1] = R[2] - R[6];
    q[2] = R[3] - R[1];
    q[3] = 1.0 + trace;
  } else {
    const int i = R[0] >= R[4] && R[0] >= R[8] ? 0 : (R[4] >= R[8] ? 1 : 2), j = (i + 1) % 3, k = (i + 2) % 3;
    q[i] = 1.0 + R[4 * i] - R[4 * j] - R[4 * k];
    q[j] = R[3 * i + j] + R[3 * j + i];
    q[k] = R[3 * i + k] + R[3 * k + i];
    q[3] = R[3 * k + j] - R[3 * j + k];
  }
  const double scale = (q[3] < 0.0 ? -1.0 : 1.0) / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int i = 0; i < 4; ++i) q[i] *= scale;
}

// From an eighth of a turn to a half turn, the half turn included.
[[gnu::noinline]] static RotationLog so3_log_far(const double* R, double* phi) {
  double q[4];
  so3_quaternion(R, q);
  const double n = std::sqrt(dot3(q, q)), angle = 2.0 * std::atan2(n, q[3]), s = angle * angle;
  for (int i = 0; i < 3; ++i) phi[i] = q[i] * (angle / n);
  const double h = (1.0 - 0.5 * angle * q[3] / n) / s;
  return {h, half_cotangent_slope_far(s, h)};
}

// Log, accurate at every angle. Up to pi/4 by the tangent of the half angle: no root and no trigonometric function.
HELIOGRAPH_INLINE RotationLog so3_log(const double* R, double* phi) {
  const double scale = 1.0 / (1.0 + R[0] + R[4] + R[8]);
  const double a[3] = {scale * (R[7] - R[5]), scale * (R[2] - R[6]), scale * (R[3] - R[1])};
  const double u = dot3(a, a);
  if (!(scale > 0.0 && scale < 1.0 && u <= kNearTangent2)) return so3_log_far(R, phi);
  const double twice = 2.0 * arc_over_tangent(u), s = twice * twice * u;
  for (int i = 0; i < 3; ++i) phi[i] = twice * a[i];
  return {half_cotangent_defect_near(s), half_cotangent_slope_near(s)};
}

HELIOGRAPH_INLINE void so3_right_jacobian_inverse(const double* phi, double h, double* J) { quadratic3(phi, 0.5, h, J); }

// out = Jl(phi)^-1 t, the translation part of a logarithm: t - phi x t / 2 + h phi x (phi x t).
HELIOGRAPH_INLINE void unroll3(const double* phi, double h, const double* t, double* out) {
  double turned[3], twice[3];
  cross3(phi, t, turned);
  cross3(phi, turned, twice);
  for (int i = 0; i < 3; ++i) out[i] = t[i] - 0.5 * turned[i] + h * twice[i];
}

// C = d(Jl(phi)^-1 t)/dphi Jr(phi)^-1: how the translation part of a logarithm answers to a turn on the right.
// With J = Jr(phi)^-1: the derivative is hat(t)/2 + h ((phi.t) I + phi t' - 2 t phi') + 2 h' (phi x (phi x t)) phi'.
HELIOGRAPH_INLINE void unroll3_jacobian(const double* phi, const RotationLog& log, const double* t, const double* J, double* C) {
  double turned[3], twice[3], D[9];
  cross3(phi, t, turned);
  cross3(phi, turned, twice);
  const double along = log.h * dot3(phi, t);
  const double half[9] = {along, -0.5 * t[2], 0.5 * t[1], 0.5 * t[2], along, -0.5 * t[0], -0.5 * t[1], 0.5 * t[0], along};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      D[3 * i + j] = half[3 * i + j] + log.h * phi[i] * t[j] + 2.0 * (log.slope * twice[i] - log.h * t[i]) * phi[j];
  multiply3(D, J, C);
}

// One step of Newton and Schulz to the nearest rotation: R (3 I - R' R) / 2. It squares the error.
HELIOGRAPH_INLINE void so3_normalize(const double* R, double* out) {
  double gram[9];
  so3_between(R, R, gram);
  for (int i = 0; i < 9; ++i) gram[i] *= -0.5;
  for (int i = 0; i < 9; i += 4) gram[i] += 1.5;
  multiply3(R, gram, out);
}

// out = R exp(phi), orthonormal; `left` (or null) receives Jl(phi).
static inline void so3_retract(const double* R, const double* phi, double* out, double* left) {
  const ExpTerms e = exp_terms(dot3(phi, phi));
  double turn[9], next[9];
  quadratic3(phi, e.sinc, e.versine, turn);
  if (left != nullptr) quadratic3(phi, e.versine, e.cubic, left);
  multiply3(R, turn, next);
  so3_normalize(next, out);
}

}  // namespace
}  // namespace heliograph::lie
