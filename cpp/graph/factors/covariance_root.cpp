// SPDX-License-Identifier: MIT
#include "graph/factors/covariance_root.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace heliograph {

// With P = U U', U upper triangular, S = U^-1: the factorisation runs from the last row upwards.
bool covariance_root(const double* P, int n, double* S) {
  const auto size = static_cast<size_t>(n);
  std::vector<double> work(size * (size + 1));
  double *scale = work.data(), *U = scale + n;
  for (int i = 0; i < n; ++i) {
    if (!(P[i * n + i] > 0.0) || !std::isfinite(P[i * n + i])) return false;
    scale[i] = 1.0 / std::sqrt(P[i * n + i]);
  }
  for (int j = n - 1; j >= 0; --j)
    for (int i = j; i >= 0; --i) {
      double x = 0.5 * (P[i * n + j] + P[j * n + i]) * scale[i] * scale[j];
      for (int k = j + 1; k < n; ++k) x -= U[i * n + k] * U[j * n + k];
      if (i == j) {
        if (!(x > 0.0) || !std::isfinite(x)) return false;
        U[i * n + i] = std::sqrt(x);
      } else {
        U[i * n + j] = x / U[j * n + j];
      }
    }
  std::fill(S, S + n * n, 0.0);
  for (int j = 0; j < n; ++j) {
    S[j * n + j] = 1.0 / U[j * n + j];
    for (int i = j - 1; i >= 0; --i) {
      double x = 0.0;
      for (int k = i + 1; k <= j; ++k) x -= U[i * n + k] * S[k * n + j];
      S[i * n + j] = x / U[i * n + i];
    }
  }
  for (int i = 0; i < n; ++i)
    for (int j = i; j < n; ++j) S[i * n + j] *= scale[j];
  return std::all_of(S, S + n * n, [](double x) { return std::isfinite(x); });
}

}  // namespace heliograph
