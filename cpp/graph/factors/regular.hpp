// SPDX-License-Identifier: MIT
// Whether small symmetric matrices are regular beyond doubt, and their factor.
#pragma once
#include <algorithm>
#include <cmath>

#include "graph/factors/manifold.hpp"

namespace heliograph {

inline constexpr double kFullRank = 1e-10;  // least pivot of a matrix with a unit diagonal that counts as regular
inline constexpr double kRounding = 1e-22;  // of the largest diagonal entry: a smaller one is what rounding leaves of zero

// Lower Cholesky factor of a symmetric n x n matrix (row-major, lower triangle read) scaled to a unit diagonal, in place.
// `magnitude` is what each diagonal entry was summed from, so that a sum of rounding errors is not taken for information.
inline bool regular_factor(double* a, int n, const double* magnitude, double* scale) {
  const double least = kRounding * *std::max_element(magnitude, magnitude + n);
  for (int i = 0; i < n; ++i) {
    if (!(magnitude[i] > least)) return false;
    scale[i] = 1.0 / std::sqrt(magnitude[i]);
  }
  for (int i = 0; i < n; ++i)
    for (int j = 0; j <= i; ++j) {
      double x = a[i * n + j] * scale[i] * scale[j];
      for (int k = 0; k < j; ++k) x -= a[i * n + k] * a[j * n + k];
      if (i == j) {
        if (!(x > kFullRank)) return false;
        a[i * n + i] = std::sqrt(x);
      } else {
        a[i * n + j] = x / a[j * n + j];
      }
    }
  return true;
}

// Whether the factor above exists, magnitudes being the diagonal: L D L' without roots, for the many that are only asked.
inline bool regular(const double* a, int n) {
  double l[kMaxDof * kMaxDof], d[kMaxDof], largest = 0.0;
  for (int i = 0; i < n; ++i) largest = std::max(largest, a[i * n + i]);
  for (int i = 0; i < n; ++i) {
    double pivot = a[i * n + i];
    const double least = std::max(kFullRank * pivot, kRounding * largest);
    for (int j = 0; j < i; ++j) {
      double x = a[i * n + j];
      for (int k = 0; k < j; ++k) x -= l[i * n + k] * l[j * n + k] * d[k];
      l[i * n + j] = x / d[j];
      pivot -= x * l[i * n + j];
    }
    if (!(pivot > least)) return false;
    d[i] = pivot;
  }
  return true;
}

}  // namespace heliograph
