// SPDX-License-Identifier: MIT
// Count, sum and outer products of points about a fixed place, and the principal axes that they give.
#pragma once
#include <algorithm>
#include <cmath>

namespace heliograph {

struct PointMoments {
  double count = 0.0;
  double sum[3] = {0.0, 0.0, 0.0};
  double outer[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};  // xx xy xz yy yz zz

  void add(double x, double y, double z) {
    count += 1.0;
    sum[0] += x;
    sum[1] += y;
    sum[2] += z;
    outer[0] += x * x;
    outer[1] += x * y;
    outer[2] += x * z;
    outer[3] += y * y;
    outer[4] += y * z;
    outer[5] += z * z;
  }

  // Adds moments that were taken about a place that lies at (x, y, z) of this one's.
  void add(const PointMoments& other, double x, double y, double z) {
    const double n = other.count;
    const double s[3] = {other.sum[0], other.sum[1], other.sum[2]};
    count += n;
    sum[0] += s[0] + n * x;
    sum[1] += s[1] + n * y;
    sum[2] += s[2] + n * z;
    outer[0] += other.outer[0] + 2.0 * x * s[0] + n * x * x;
    outer[1] += other.outer[1] + x * s[1] + y * s[0] + n * x * y;
    outer[2] += other.outer[2] + x * s[2] + z * s[0] + n * x * z;
    outer[3] += other.outer[3] + 2.0 * y * s[1] + n * y * y;
    outer[4] += other.outer[4] + y * s[2] + z * s[1] + n * y * z;
    outer[5] += other.outer[5] + 2.0 * z * s[2] + n * z * z;
  }

  // Unbiased covariance, xx xy xz yy yz zz; zero for fewer than two points.
  void covariance(double* out) const {
    const double inverse = count > 1.0 ? 1.0 / (count - 1.0) : 0.0;
    const double mean[3] = {sum[0] / count, sum[1] / count, sum[2] / count};
    out[0] = (outer[0] - sum[0] * mean[0]) * inverse;
    out[1] = (outer[1] - sum[0] * mean[1]) * inverse;
    out[2] = (outer[2] - sum[0] * mean[2]) * inverse;
    out[3] = (outer[3] - sum[1] * mean[1]) * inverse;
    out[4] = (outer[4] - sum[1] * mean[2]) * inverse;
    out[5] = (outer[5] - sum[2] * mean[2]) * inverse;
  }
};

// Eigenvalues (ascending) and unit eigenvectors (rows) of a symmetric 3x3 matrix xx xy xz yy yz zz, by Jacobi's
// rotations: exact to rounding for repeated and for zero eigenvalues, which closed forms are not.
inline void principal_axes(const double* c, double* values, double* axes) {
  double A[3][3] = {{c[0], c[1], c[2]}, {c[1], c[3], c[4]}, {c[2], c[4], c[5]}};
  double V[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const double scale = std::abs(c[0]) + std::abs(c[3]) + std::abs(c[5]);
  for (int sweep = 0; sweep < 12; ++sweep) {
    if (std::abs(A[0][1]) + std::abs(A[0][2]) + std::abs(A[1][2]) <= 1e-15 * scale) break;
    for (int p = 0; p < 2; ++p)
      for (int q = p + 1; q < 3; ++q) {
        if (A[p][q] == 0.0) continue;
        const double theta = (A[q][q] - A[p][p]) / (2.0 * A[p][q]);
        const double t = (theta >= 0.0 ? 1.0 : -1.0) / (std::abs(theta) + std::sqrt(theta * theta + 1.0));
        const double cosine = 1.0 / std::sqrt(t * t + 1.0), sine = t * cosine;
        const int r = 3 - p - q;
        const double apq = A[p][q], apr = A[p][r], aqr = A[q][r];
        A[p][p] -= t * apq;
        A[q][q] += t * apq;
        A[p][q] = A[q][p] = 0.0;
        A[p][r] = A[r][p] = cosine * apr - sine * aqr;
        A[q][r] = A[r][q] = sine * apr + cosine * aqr;
        for (auto& row : V) {
          const double vp = row[p], vq = row[q];
          row[p] = cosine * vp - sine * vq;
          row[q] = sine * vp + cosine * vq;
        }
      }
  }
  int order[3] = {0, 1, 2};
  if (A[order[1]][order[1]] < A[order[0]][order[0]]) std::swap(order[0], order[1]);
  if (A[order[2]][order[2]] < A[order[1]][order[1]]) std::swap(order[1], order[2]);
  if (A[order[1]][order[1]] < A[order[0]][order[0]]) std::swap(order[0], order[1]);
  for (int i = 0; i < 3; ++i) {
    values[i] = std::max(A[order[i]][order[i]], 0.0);
    for (int k = 0; k < 3; ++k) axes[3 * i + k] = V[k][order[i]];
  }
}

// The same where the eigenvalues are well apart and none is below zero, in a fifth of the time: Newton's iteration climbs to
// the smallest root of the characteristic polynomial from zero without passing it, the others solve what is left of it, and
// the vectors are cross products.
inline void symmetric_axes(const double* c, double* values, double* axes) {
  const double trace = c[0] + c[3] + c[5];
  const double minors = c[0] * c[3] + c[0] * c[5] + c[3] * c[5] - c[1] * c[1] - c[2] * c[2] - c[4] * c[4];
  const double det = c[0] * (c[3] * c[5] - c[4] * c[4]) - c[1] * (c[1] * c[5] - c[4] * c[2]) + c[2] * (c[1] * c[4] - c[3] * c[2]);
  double low = 0.0;
  for (int k = 0; k < 12; ++k) {
    const double value = ((low - trace) * low + minors) * low - det, slope = (3.0 * low - 2.0 * trace) * low + minors;
    const double step = value / slope;
    low -= step;
    if (!(std::abs(step) > 1e-15 * trace)) break;
  }
  const double half = 0.5 * (trace - low), rest = minors - low * (trace - low);
  const double root = std::sqrt(std::max(half * half - rest, 0.0)), high = half + root, mid = half - root;
  // Cross products lose the vectors where two values are close together, Newton crawls to double roots; NaN compares false.
  if (!(mid - low > 1e-3 * high && high - mid > 1e-3 * high)) return principal_axes(c, values, axes);
  const auto null_vector = [&](double value, double* out) {
    const double rows[3][3] = {{c[0] - value, c[1], c[2]}, {c[1], c[3] - value, c[4]}, {c[2], c[4], c[5] - value}};
    double best = -1.0;
    for (int i = 0; i < 3; ++i) {
      const double *a = rows[i], *b = rows[(i + 1) % 3];
      const double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
      const double square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
      if (square <= best) continue;
      best = square;
      const double scale = 1.0 / std::sqrt(square);
      for (int k = 0; k < 3; ++k) out[k] = n[k] * scale;
    }
  };
  null_vector(low, axes);
  null_vector(high, axes + 6);
  // Across the two others, so that the three stay orthogonal but for rounding.
  const double *a = axes, *b = axes + 6;
  axes[3] = b[1] * a[2] - b[2] * a[1];
  axes[4] = b[2] * a[0] - b[0] * a[2];
  axes[5] = b[0] * a[1] - b[1] * a[0];
  values[0] = std::max(low, 0.0);
  values[1] = mid;
  values[2] = high;
}

}  // namespace heliograph
