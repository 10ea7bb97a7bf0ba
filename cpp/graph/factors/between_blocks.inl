// SPDX-License-Identifier: MIT
// The blocks of between factors of poses, by far the most frequent, by their structure. With the whitened B = S Jr^-1,
// M = w B' B and A = Ad((Xi^-1 Xj)^-1): H_jj = M, H_ij = -A' M, H_ii = A' M A, g_j = w B' r, g_i = -A' g_j.
// The stacked row of normal_blocks.inl would be written number by number and read in vectors, for which a processor waits.
#pragma once
#include "graph/factors/residuals_pose.inl"

namespace heliograph {
namespace {

// Upper triangle of S, whatever its form, at `own` or where it lies. `own` is zero but for its diagonal.
template <int kRows>
HELIOGRAPH_INLINE const double* full_noise(const FactorView& v, size_t k, double* own) {
  const double* S = noise_of(v, k, kRows);
  if (v.noise == NoiseForm::full) return S;
  for (int i = 0; i < kRows; ++i) own[i * kRows + i] = v.noise == NoiseForm::scalar ? S[0] : S[i];
  return own;
}

template <int kRows>
HELIOGRAPH_INLINE void whiten_vector(const double* S, const double* r, double* out) {
  for (int i = 0; i < kRows; ++i) {
    double sum = S[i * kRows + i] * r[i];
    for (int k = i + 1; k < kRows; ++k) sum += S[i * kRows + k] * r[k];
    out[i] = sum;
  }
}

// A' M, M and the gradient of SE(2) into the factor's 33 numbers; A = [1 0; a R'], R of D.
HELIOGRAPH_INLINE void write_se2(const double* D, const double (&M)[6], const double (&g)[3], double* out) {
  const double c = D[0], s = D[1], a0 = s * D[2] - c * D[3], a1 = c * D[2] + s * D[3];
  const double m[3][3] = {{M[0], M[1], M[2]}, {M[1], M[3], M[4]}, {M[2], M[4], M[5]}};
  double U[3][3];
  for (int q = 0; q < 3; ++q) {
    U[0][q] = m[0][q] + a0 * m[1][q] + a1 * m[2][q];
    U[1][q] = c * m[1][q] - s * m[2][q];
    U[2][q] = s * m[1][q] + c * m[2][q];
  }
  const double ii00 = U[0][0] + a0 * U[0][1] + a1 * U[0][2];
  const double ii01 = c * U[0][1] - s * U[0][2], ii02 = s * U[0][1] + c * U[0][2];
  const double ii11 = c * U[1][1] - s * U[1][2], ii12 = s * U[1][1] + c * U[1][2], ii22 = s * U[2][1] + c * U[2][2];
  const double ii[9] = {ii00, ii01, ii02, ii01, ii11, ii12, ii02, ii12, ii22};
  for (int i = 0; i < 9; ++i) out[i] = ii[i];
  for (int i = 0; i < 9; ++i) out[9 + i] = -U[i / 3][i % 3];
  for (int i = 0; i < 9; ++i) out[18 + i] = m[i / 3][i % 3];
  out[27] = -(g[0] + a0 * g[1] + a1 * g[2]);
  out[28] = -(c * g[1] - s * g[2]);
  out[29] = -(s * g[1] + c * g[2]);
  for (int i = 0; i < 3; ++i) out[30 + i] = g[i];
}

static void linearize_between_se2(const FactorView& v, size_t begin, size_t end, double* blocks, GroupCost* sum) {
  double own[9] = {};
  GroupCost total;
  for (size_t k = begin; k < end; ++k, blocks += 33) {
    double D[4], E[4], r[3], white[3];
    lie::se2_between(value_of(v, k, 2, 0), value_of(v, k, 2, 1), D);
    lie::se2_between(measurement_of(v, k, 4), D, E);
    const lie::Se2Jacobian J = lie::se2_log(E, r);
    const double* S = full_noise<3>(v, k, own);
    whiten_vector<3>(S, r, white);
    const double w = weigh(v, k, 3, 1, white, &total);
    double B[3][3];
    for (int i = 0; i < 3; ++i) {
      const double turn = i == 0 ? S[0] : 0.0, x = i <= 1 ? S[3 * i + 1] : 0.0, y = S[3 * i + 2];
      B[i][0] = turn + x * J.w[0] + y * J.w[1];
      B[i][1] = x * J.g + y * J.q;
      B[i][2] = y * J.g - x * J.q;
    }
    double M[6] = {}, g[3] = {};
    for (int i = 0; i < 3; ++i) {
      const double b0 = w * B[i][0], b1 = w * B[i][1], b2 = w * B[i][2];
      M[0] += b0 * B[i][0];
      M[1] += b0 * B[i][1];
      M[2] += b0 * B[i][2];
      M[3] += b1 * B[i][1];
      M[4] += b1 * B[i][2];
      M[5] += b2 * B[i][2];
      g[0] += b0 * white[i];
      g[1] += b1 * white[i];
      g[2] += b2 * white[i];
    }
    write_se2(D, M, g, blocks);
  }
  *sum = total;
}

// Rows of three numbers, and 3x3 matrices of them. With AVX a row is one vector whose fourth lane is not used.
#if defined(__AVX__)
typedef double Row __attribute__((vector_size(32)));
typedef double LooseRow __attribute__((vector_size(32), aligned(8), may_alias));

HELIOGRAPH_INLINE Row row_of(double x, double y, double z) { return Row{x, y, z, 0.0}; }

// What is written behind the three numbers is written again by the next row.
HELIOGRAPH_INLINE void store_row(const Row& row, double* out) { *reinterpret_cast<LooseRow*>(out) = row; }
#else
struct Row {
  double x[3];
  double operator[](int i) const { return x[i]; }
  Row operator-() const { return {-x[0], -x[1], -x[2]}; }
  Row operator-(const Row& b) const { return {x[0] - b.x[0], x[1] - b.x[1], x[2] - b.x[2]}; }
  void operator+=(const Row& b) { x[0] += b.x[0], x[1] += b.x[1], x[2] += b.x[2]; }
};

HELIOGRAPH_INLINE Row operator*(double s, const Row& a) { return {s * a.x[0], s * a.x[1], s * a.x[2]}; }
HELIOGRAPH_INLINE Row row_of(double x, double y, double z) { return {x, y, z}; }
HELIOGRAPH_INLINE void store_row(const Row& row, double* out) { out[0] = row.x[0], out[1] = row.x[1], out[2] = row.x[2]; }
#endif

constexpr int kRowStep = sizeof(Row) / sizeof(double);

struct Rows3 {
  Row row[3];
};

HELIOGRAPH_INLINE void load3(const double* M, Rows3* out) {
  for (int i = 0; i < 3; ++i) out->row[i] = row_of(M[3 * i], M[3 * i + 1], M[3 * i + 2]);
}

// C += s * left B, where left(i, k) is the number at row i and column k of a matrix.
HELIOGRAPH_INLINE void add_product(const double* left, int row_step, int column_step, const Rows3& B, Rows3* C) {
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) C->row[i] += left[i * row_step + k * column_step] * B.row[k];
}

// The same with a left matrix that is upper triangular.
HELIOGRAPH_INLINE void add_upper_product(const double* left, int row_step, const Rows3& B, Rows3* C) {
  for (int i = 0; i < 3; ++i)
    for (int k = i; k < 3; ++k) C->row[i] += left[i * row_step + k] * B.row[k];
}

HELIOGRAPH_INLINE const double* numbers(const Rows3& M) { return reinterpret_cast<const double*>(M.row); }

// C += hat(t) B.
HELIOGRAPH_INLINE void add_hat_product(const double* t, const Rows3& B, Rows3* C) {
  C->row[0] += t[1] * B.row[2] - t[2] * B.row[1];
  C->row[1] += t[2] * B.row[0] - t[0] * B.row[2];
  C->row[2] += t[0] * B.row[1] - t[1] * B.row[0];
}

// Two 3x3 parts side by side into three rows of six.
HELIOGRAPH_INLINE void store3(const Rows3& left, const Rows3& right, double sign, double* out) {
  for (int i = 0; i < 3; ++i) {
    store_row(sign * left.row[i], out + 6 * i);
    store_row(sign * right.row[i], out + 6 * i + 3);
  }
}

// A 6x6 matrix by its 3x3 parts.
struct Blocks6 {
  Rows3 part[2][2];
};

// B = S J with J = [J 0; C J].
HELIOGRAPH_INLINE void whiten_se3(const double* S, const double* J, const double* C, Blocks6* B) {
  Rows3 j, c;
  load3(J, &j);
  load3(C, &c);
  *B = Blocks6{};
  add_upper_product(S, 6, j, &B->part[0][0]);
  add_product(S + 3, 6, 1, c, &B->part[0][0]);
  add_product(S + 3, 6, 1, j, &B->part[0][1]);
  add_upper_product(S + 21, 6, c, &B->part[1][0]);
  add_upper_product(S + 21, 6, j, &B->part[1][1]);
}

// M = w B' B and g = w B' r.
HELIOGRAPH_INLINE void normal_se3(const Blocks6& B, const double* r, double w, Blocks6* M, double* g) {
  *M = Blocks6{};
  for (int b = 0; b < 2; ++b) {
    Row gradient = {};
    for (int k = 0; k < 2; ++k) {
      Rows3 scaled;
      for (int i = 0; i < 3; ++i) {
        scaled.row[i] = w * B.part[k][b].row[i];
        gradient += r[3 * k + i] * scaled.row[i];
      }
      for (int a = 0; a < 2; ++a) add_product(numbers(B.part[k][a]), 1, kRowStep, scaled, &M->part[a][b]);
    }
    for (int i = 0; i < 3; ++i) g[3 * b + i] = gradient[i];
  }
}

// With D = (R, t): A' = [R hat(t) R; 0 R], so that A' M is R M below and R M + hat(t) (R M below) above.
HELIOGRAPH_INLINE void write_se3(const double* D, const Blocks6& M, const double* g, double* out) {
  const double* t = D + 9;
  Blocks6 U{}, V{};
  Rows3 transposed, turned{};  // R' and R' hat(t)
  for (int i = 0; i < 3; ++i) transposed.row[i] = row_of(D[i], D[3 + i], D[6 + i]);
  for (int i = 0; i < 3; ++i) {
    const double column[3] = {D[i], D[3 + i], D[6 + i]};
    double crossed[3];
    lie::cross3(column, t, crossed);
    turned.row[i] = row_of(crossed[0], crossed[1], crossed[2]);
  }
  for (int b = 0; b < 2; ++b) {
    add_product(D, 3, 1, M.part[1][b], &U.part[1][b]);
    add_product(D, 3, 1, M.part[0][b], &U.part[0][b]);
    add_hat_product(t, U.part[1][b], &U.part[0][b]);
  }
  // U A with A = [R' 0; -R' hat(t) R'].
  for (int a = 0; a < 2; ++a) {
    for (int i = 0; i < 3; ++i) turned.row[i] = a == 0 ? -turned.row[i] : turned.row[i];
    add_product(numbers(U.part[a][0]), kRowStep, 1, transposed, &V.part[a][0]);
    add_product(numbers(U.part[a][1]), kRowStep, 1, turned, &V.part[a][0]);
    add_product(numbers(U.part[a][1]), kRowStep, 1, transposed, &V.part[a][1]);
  }
  for (int a = 0; a < 2; ++a) store3(V.part[a][0], V.part[a][1], 1.0, out + 18 * a);
  for (int a = 0; a < 2; ++a) store3(U.part[a][0], U.part[a][1], -1.0, out + 36 + 18 * a);
  for (int a = 0; a < 2; ++a) store3(M.part[a][0], M.part[a][1], 1.0, out + 72 + 18 * a);
  double low[3], high[3], lever[3];
  lie::so3_rotate(D, g, high);
  lie::so3_rotate(D, g + 3, low);
  lie::cross3(t, low, lever);
  for (int i = 0; i < 3; ++i) {
    out[108 + i] = -(high[i] + lever[i]);
    out[111 + i] = -low[i];
  }
  for (int i = 0; i < 6; ++i) out[114 + i] = g[i];
}

static void linearize_between_se3(const FactorView& v, size_t begin, size_t end, double* blocks, GroupCost* sum) {
  double own[36] = {};
  GroupCost total;
  for (size_t k = begin; k < end; ++k, blocks += 120) {
    double D[12], E[12], r[6], white[6], J[9], C[9], g[6];
    lie::motion_between<1>(value_of(v, k, 2, 0), value_of(v, k, 2, 1), D);
    lie::motion_between<1>(measurement_of(v, k, 12), D, E);
    const lie::RotationLog log = lie::motion_log<1>(E, r);
    lie::so3_right_jacobian_inverse(r, log.h, J);
    lie::unroll3_jacobian(r, log, E + 9, J, C);
    const double* S = full_noise<6>(v, k, own);
    whiten_vector<6>(S, r, white);
    const double w = weigh(v, k, 6, 1, white, &total);
    Blocks6 B, M;
    whiten_se3(S, J, C, &B);
    normal_se3(B, white, w, &M, g);
    write_se3(D, M, g, blocks);
  }
  *sum = total;
}

template <>
struct Linearizer<BetweenSe2> {
  static constexpr auto run = linearize_between_se2;
};

template <>
struct Linearizer<BetweenMotion<1, 1, 1>> {
  static constexpr auto run = linearize_between_se3;
};

}  // namespace
}  // namespace heliograph
