// SPDX-License-Identifier: MIT
#include "lie/batch.hpp"

#include <cmath>

#include "lie/se2.hpp"
#include "lie/so3.hpp"

namespace heliograph {

namespace {

using namespace lie;

constexpr double kNearSquare = 0.61685;  // (pi/4)^2, up to where the series of the half cotangent hold

constexpr Series kQuartic = alternating(4);

// (-1)^k (k + 1) / (2k + 5)!
constexpr Series rising() {
  Series out = alternating(5);
  for (int k = 0; k < kSeriesTerms; ++k) out.c[k] *= k + 1;
  return out;
}
constexpr Series kQuintic = rising();

// (t^2/2 + cos t - 1) / t^4 and (2t - 3 sin t + t cos t) / (2 t^5).
void high_terms(double s, double* quartic, double* quintic) {
  if (s < 4.0) {
    *quartic = polynomial(kQuartic.c, s);
    *quintic = polynomial(kQuintic.c, s);
    return;
  }
  const double t = std::sqrt(s), sine = std::sin(t), cosine = std::cos(t);
  *quartic = (0.5 * s + cosine - 1.0) / (s * s);
  *quintic = (2.0 * t - 3.0 * sine + t * cosine) / (2.0 * s * s * t);
}

// h = (1 - (t/2) cot(t/2)) / t^2 and its derivative by s = t^2.
RotationLog half_cotangent(double s) {
  if (s < kNearSquare) return {half_cotangent_defect_near(s), half_cotangent_slope_near(s)};
  const double t = std::sqrt(s), h = (1.0 - 0.5 * t / std::tan(0.5 * t)) / s;
  return {h, half_cotangent_slope_far(s, h)};
}

// ---- SO(3) ----

void so3_exp_one(const double* phi, double* R) {
  const ExpTerms e = exp_terms(dot3(phi, phi));
  quadratic3(phi, e.sinc, e.versine, R);
}

void so3_log_one(const double* R, double* phi) { so3_log(R, phi); }

void so3_left(const double* phi, double* J) {
  const ExpTerms e = exp_terms(dot3(phi, phi));
  quadratic3(phi, e.versine, e.cubic, J);
}

void so3_right(const double* phi, double* J) {
  const ExpTerms e = exp_terms(dot3(phi, phi));
  quadratic3(phi, -e.versine, e.cubic, J);
}

void so3_left_inverse(const double* phi, double* J) { quadratic3(phi, -0.5, half_cotangent(dot3(phi, phi)).h, J); }
void so3_right_inverse(const double* phi, double* J) { quadratic3(phi, 0.5, half_cotangent(dot3(phi, phi)).h, J); }

// ---- SE(2): [c -s x; s c y; 0 0 1] ----

void planar(double c, double s, double x, double y, double* T) {
  const double rows[9] = {c, -s, x, s, c, y, 0.0, 0.0, 1.0};
  for (int i = 0; i < 9; ++i) T[i] = rows[i];
}

void se2_exp_one(const double* v, double* T) {
  const ExpTerms e = exp_terms(v[0] * v[0]);
  const double arc[2] = {e.sinc, v[0] * e.versine};
  double t[2];
  so2_rotate(arc, v + 1, t);
  planar(std::cos(v[0]), std::sin(v[0]), t[0], t[1], T);
}

void se2_log_one(const double* T, double* r) {
  const PlaneAngle log = so2_log(T[0], T[3]);
  const double half = 0.5 * log.angle;
  r[0] = log.angle;
  r[1] = log.g * T[2] + half * T[5];
  r[2] = log.g * T[5] - half * T[2];
}

void se2_compose_one(const double* A, const double* B, double* C) {
  for (int i = 0; i < 6; i += 3) {
    const double x = A[i], y = A[i + 1];
    for (int j = 0; j < 3; ++j) C[i + j] = x * B[j] + y * B[3 + j];
    C[i + 2] += A[i + 2];
  }
  C[6] = C[7] = 0.0;
  C[8] = 1.0;
}

void se2_inverse_one(const double* T, double* out) {
  const double rows[9] = {T[0], T[3], -(T[0] * T[2] + T[3] * T[5]), T[1], T[4], -(T[1] * T[2] + T[4] * T[5]), 0.0, 0.0, 1.0};
  for (int i = 0; i < 9; ++i) out[i] = rows[i];
}

void se2_adjoint_one(const double* T, double* out) {
  const double rows[9] = {1.0, 0.0, 0.0, T[5], T[0], T[1], -T[2], T[3], T[4]};
  for (int i = 0; i < 9; ++i) out[i] = rows[i];
}

void se2_right(const double* v, double* J) {
  const ExpTerms e = exp_terms(v[0] * v[0]);
  const double b = e.versine, c = v[0] * e.cubic, slant = v[0] * b;
  const double rows[9] = {1.0, 0.0, 0.0, v[1] * c - v[2] * b, e.sinc, slant, v[1] * b + v[2] * c, -slant, e.sinc};
  for (int i = 0; i < 9; ++i) J[i] = rows[i];
}

// With g = 1 - t^2 h the coupling (inverse block times coupling of the Jacobian) comes down to t h rho and rho / 2.
void se2_right_inverse(const double* v, double* J) {
  const double s = v[0] * v[0], h = half_cotangent(s).h, g = 1.0 - s * h, q = 0.5 * v[0], lean = v[0] * h;
  const double rows[9] = {1.0, 0.0, 0.0, lean * v[1] + 0.5 * v[2], g, -q, lean * v[2] - 0.5 * v[1], q, g};
  for (int i = 0; i < 9; ++i) J[i] = rows[i];
}

// ---- SE(3): [R t; 0 1] ----

void rotation_of(const double* T, double* R) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R[3 * i + j] = T[4 * i + j];
}

void spatial(const double* R, const double* t, double* T) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T[4 * i + j] = R[3 * i + j];
    T[4 * i + 3] = t[i];
  }
  T[12] = T[13] = T[14] = 0.0;
  T[15] = 1.0;
}

void se3_exp_one(const double* v, double* T) {
  const ExpTerms e = exp_terms(dot3(v, v));
  double R[9], left[9], t[3];
  quadratic3(v, e.sinc, e.versine, R);
  quadratic3(v, e.versine, e.cubic, left);
  so3_rotate(left, v + 3, t);
  spatial(R, t, T);
}

void se3_log_one(const double* T, double* r) {
  double R[9];
  rotation_of(T, R);
  const double t[3] = {T[3], T[7], T[11]};
  const RotationLog log = so3_log(R, r);
  unroll3(r, log.h, t, r + 3);
}

void se3_compose_one(const double* A, const double* B, double* C) {
  for (int i = 0; i < 12; i += 4) {
    for (int j = 0; j < 4; ++j) C[i + j] = A[i] * B[j] + A[i + 1] * B[4 + j] + A[i + 2] * B[8 + j];
    C[i + 3] += A[i + 3];
  }
  C[12] = C[13] = C[14] = 0.0;
  C[15] = 1.0;
}

void se3_inverse_one(const double* T, double* out) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[4 * i + j] = T[4 * j + i];
    out[4 * i + 3] = -(T[i] * T[3] + T[4 + i] * T[7] + T[8 + i] * T[11]);
  }
  out[12] = out[13] = out[14] = 0.0;
  out[15] = 1.0;
}

// [rotation 0; coupling rotation].
void block_lower(const double* rotation, const double* coupling, double* out) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      out[6 * i + j] = out[6 * (i + 3) + j + 3] = rotation[3 * i + j];
      out[6 * i + j + 3] = 0.0;
      out[6 * (i + 3) + j] = coupling[3 * i + j];
    }
}

void se3_adjoint_one(const double* T, double* out) {
  double R[9], coupling[9];
  rotation_of(T, R);
  for (int j = 0; j < 3; ++j) {
    coupling[j] = T[7] * R[6 + j] - T[11] * R[3 + j];
    coupling[3 + j] = T[11] * R[j] - T[3] * R[6 + j];
    coupling[6 + j] = T[3] * R[3 + j] - T[7] * R[j];
  }
  block_lower(R, coupling, out);
}

void hat3(const double* v, double* K) {
  const double rows[9] = {0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0};
  for (int i = 0; i < 9; ++i) K[i] = rows[i];
}

// The Q block of the left Jacobian at the negated tangent (Barfoot, State Estimation for Robotics, eq. 7.86).
void se3_right(const double* v, double* J) {
  const double phi[3] = {-v[0], -v[1], -v[2]}, rho[3] = {-v[3], -v[4], -v[5]};
  const double s = dot3(phi, phi);
  const ExpTerms e = exp_terms(s);
  double quartic, quintic;
  high_terms(s, &quartic, &quintic);
  double K[9], P[9], KP[9], PK[9], KPK[9], KKP[9], PKK[9], KPKK[9], KKPK[9], Q[9], block[9];
  hat3(phi, K);
  hat3(rho, P);
  multiply3(K, P, KP);
  multiply3(P, K, PK);
  multiply3(KP, K, KPK);
  multiply3(K, KP, KKP);
  multiply3(PK, K, PKK);
  multiply3(KPK, K, KPKK);
  multiply3(K, KPK, KKPK);
  for (int i = 0; i < 9; ++i)
    Q[i] = 0.5 * P[i] + e.cubic * (KP[i] + PK[i] + KPK[i]) + quartic * (KKP[i] + PKK[i] - 3.0 * KPK[i]) +
           quintic * (KPKK[i] + KKPK[i]);
  quadratic3(v, -e.versine, e.cubic, block);
  block_lower(block, Q, J);
}

// The coupling is how the translation part of the logarithm of exp(v) answers to a turn on the right.
void se3_right_inverse(const double* v, double* J) {
  const double s = dot3(v, v);
  const ExpTerms e = exp_terms(s);
  const RotationLog log = half_cotangent(s);
  double left[9], t[3], block[9], coupling[9];
  quadratic3(v, e.versine, e.cubic, left);
  so3_rotate(left, v + 3, t);
  so3_right_jacobian_inverse(v, log.h, block);
  unroll3_jacobian(v, log, t, block, coupling);
  block_lower(block, coupling, J);
}

template <size_t In, size_t Out, void (*F)(const double*, double*)>
void each(const double* in, double* out, size_t count) {
  for (size_t i = 0; i < count; ++i) F(in + i * In, out + i * Out);
}

template <size_t Size, void (*F)(const double*, const double*, double*)>
void each_pair(const double* a, const double* b, double* out, size_t count) {
  for (size_t i = 0; i < count; ++i) F(a + i * Size, b + i * Size, out + i * Size);
}

}  // namespace

const UnaryMap unary_maps[kUnaryMaps] = {
    {"so3_exp", 3, 9, each<3, 9, so3_exp_one>},
    {"so3_log", 9, 3, each<9, 3, so3_log_one>},
    {"so3_left_jacobian", 3, 9, each<3, 9, so3_left>},
    {"so3_right_jacobian", 3, 9, each<3, 9, so3_right>},
    {"so3_left_jacobian_inverse", 3, 9, each<3, 9, so3_left_inverse>},
    {"so3_right_jacobian_inverse", 3, 9, each<3, 9, so3_right_inverse>},
    {"se2_exp", 3, 9, each<3, 9, se2_exp_one>},
    {"se2_log", 9, 3, each<9, 3, se2_log_one>},
    {"se2_inverse", 9, 9, each<9, 9, se2_inverse_one>},
    {"se2_adjoint", 9, 9, each<9, 9, se2_adjoint_one>},
    {"se2_right_jacobian", 3, 9, each<3, 9, se2_right>},
    {"se2_right_jacobian_inverse", 3, 9, each<3, 9, se2_right_inverse>},
    {"se3_exp", 6, 16, each<6, 16, se3_exp_one>},
    {"se3_log", 16, 6, each<16, 6, se3_log_one>},
    {"se3_inverse", 16, 16, each<16, 16, se3_inverse_one>},
    {"se3_adjoint", 16, 36, each<16, 36, se3_adjoint_one>},
    {"se3_right_jacobian", 6, 36, each<6, 36, se3_right>},
    {"se3_right_jacobian_inverse", 6, 36, each<6, 36, se3_right_inverse>},
};

const BinaryMap binary_maps[kBinaryMaps] = {
    {"se2_compose", 9, each_pair<9, se2_compose_one>},
    {"se3_compose", 16, each_pair<16, se3_compose_one>},
};

}  // namespace heliograph
