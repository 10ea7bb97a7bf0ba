// SPDX-License-Identifier: MIT
// Directions in space as unit vectors; tangent: two angles along the basis of src/heliograph/lie/s2.py.
#pragma once
#include "lie/so3.hpp"

namespace heliograph::lie {
namespace {

constexpr double kS2Seam = 0.866;  // as in lie/s2.py: one basis for both

// The basis' two columns, each a vector of three.
HELIOGRAPH_INLINE void s2_basis(const double* x, double* first, double* second) {
  const double s = x[2] > kS2Seam ? 1.0 : -1.0, a = -1.0 / (s + x[2]), b = x[0] * x[1] * a;
  first[0] = 1.0 + s * x[0] * x[0] * a;
  first[1] = s * b;
  first[2] = -s * x[0];
  second[0] = b;
  second[1] = s + x[1] * x[1] * a;
  second[2] = -x[1];
}

// r = z.local(y) and, if G is not null, dr/dy (2x3) along the sphere. With tau = B' y, n = |tau| = sin(angle),
// f = angle / n: dr = f dtau + (cos - f) / n^2 tau tau' dtau - tau d(z.y). Opposite to z the direction of r is a choice, and
// what would be infinite there is left out.
static inline void s2_local(const double* z, const double* y, double* r, double* G) {
  double first[3], second[3];
  s2_basis(z, first, second);
  const double tau[2] = {dot3(first, y), dot3(second, y)}, cosine = dot3(z, y);
  const double n2 = tau[0] * tau[0] + tau[1] * tau[1], n = std::sqrt(n2), angle = std::atan2(n, cosine);
  const bool opposite = n == 0.0 && cosine < 0.0;
  const double f = n > 0.0 ? angle / n : 1.0;
  r[0] = opposite ? angle : f * tau[0];
  r[1] = opposite ? 0.0 : f * tau[1];
  if (G == nullptr) return;
  if (opposite) {
    for (int i = 0; i < 3; ++i) G[i] = -first[i], G[3 + i] = 0.0;
    return;
  }
  // (cos - f) / n^2 = -4 f^3 (2a - sin 2a) / (2a)^3, which does not cancel near zero.
  const double k = cosine > 0.0 ? -4.0 * f * f * f * exp_terms(4.0 * angle * angle).cubic
                                : (n2 > 0.0 ? (cosine - f) / n2 : 0.0);
  for (int i = 0; i < 3; ++i) {
    const double along = k * (tau[0] * first[i] + tau[1] * second[i]) - z[i];
    G[i] = f * first[i] + tau[0] * along;
    G[3 + i] = f * second[i] + tau[1] * along;
  }
}

static inline void s2_retract(const double* x, const double* d, double* out) {
  double first[3], second[3], y[3];
  s2_basis(x, first, second);
  const double s = d[0] * d[0] + d[1] * d[1], sinc = exp_terms(s).sinc, cosine = std::cos(std::sqrt(s));
  for (int i = 0; i < 3; ++i) y[i] = cosine * x[i] + sinc * (d[0] * first[i] + d[1] * second[i]);
  const double scale = 1.0 / std::sqrt(dot3(y, y));
  for (int i = 0; i < 3; ++i) out[i] = scale * y[i];
}

}  // namespace
}  // namespace heliograph::lie
