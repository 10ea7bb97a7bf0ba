// SPDX-License-Identifier: MIT
#include "graph/factors/pack.hpp"

#include <algorithm>
#include <cmath>

namespace heliograph {

namespace {

bool finite(const double* x, int n) { return std::all_of(x, x + n, [](double v) { return std::isfinite(v); }); }

bool rotation2(const double* m, double c, double s) {
  return std::abs(c - m[1]) + std::abs(s + m[0]) + std::abs(c * c + s * s - 1.0) <= kOffManifold;
}

bool rotation3(const double* R) {
  double skew = 0.0;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) {
      const double dot = R[i] * R[j] + R[3 + i] * R[3 + j] + R[6 + i] * R[6 + j];
      skew = std::max(skew, std::abs(dot - (i == j ? 1.0 : 0.0)));
    }
  const double det = R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]);
  return skew + std::abs(det - 1.0) <= kOffManifold;
}

}  // namespace

bool pack_single(Manifold manifold, int dof, const double* x, int64_t row, int64_t column, double* out) {
  const auto at = [&](int i, int j) { return x[i * row + j * column]; };
  const int storage = storage_of(manifold, dof);
  if (manifold == Manifold::vector || manifold == Manifold::s2) {
    for (int i = 0; i < storage; ++i) out[i] = x[i * row];
    const double square = manifold == Manifold::s2 ? out[0] * out[0] + out[1] * out[1] + out[2] * out[2] : 1.0;
    return finite(out, storage) && std::abs(square - 1.0) <= kOffManifold;
  }
  const int size = manifold == Manifold::so2 || manifold == Manifold::se2 ? 2 : 3;
  if (size == 2) {
    out[0] = at(0, 0), out[1] = at(1, 0);
    if (manifold == Manifold::se2) out[2] = at(0, 2), out[3] = at(1, 2);
    const double second[2] = {at(0, 1), at(1, 1)};
    return finite(out, storage) && rotation2(second, out[0], out[1]);
  }
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[3 * i + j] = at(i, j);
  for (int k = 9; k < storage; ++k) out[k] = at(k % 3, k / 3);
  return finite(out, storage) && rotation3(out);
}

}  // namespace heliograph
