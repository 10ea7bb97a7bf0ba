// SPDX-License-Identifier: MIT
// Rigid motions in the plane as (cos, sin, x, y); tangent (theta, x, y).
#pragma once
#include "lie/so2.hpp"

namespace heliograph::lie {
namespace {

// A^-1 B.
HELIOGRAPH_INLINE void se2_between(const double* a, const double* b, double* out) {
  so2_between(a, b, out);
  const double d[2] = {b[2] - a[2], b[3] - a[3]};
  so2_rotate_back(a, d, out + 2);
}

// The inverse of the right Jacobian at Log(E): [1 0 0; w0 g -q; w1 q g].
struct Se2Jacobian {
  double w[2], g, q;
};

// r = Log(E). The translation of E stays where it is when E is turned on the right, so the coupling is the derivative
// of V(theta)^-1 t alone, with dg/dtheta = theta (g h - 1/4) = (g (1 - g) - (theta/2)^2) / theta.
HELIOGRAPH_INLINE Se2Jacobian se2_log(const double* E, double* r) {
  const PlaneAngle log = so2_log(E[0], E[1]);
  const double q = 0.5 * log.angle, g = log.g, s = log.angle * log.angle;
  r[0] = log.angle;
  r[1] = g * E[2] + q * E[3];
  r[2] = g * E[3] - q * E[2];
  const double h = s <= 0.617 ? half_cotangent_defect_near(s) : (1.0 - g) / s;  // (pi/4)^2
  const double slope = log.angle * (g * h - 0.25);
  return {{slope * E[2] + 0.5 * E[3], slope * E[3] - 0.5 * E[2]}, g, q};
}

// x <- x exp(d).
static inline void se2_retract(const double* x, const double* d, double* out) {
  const ExpTerms e = exp_terms(d[0] * d[0]);
  const double arc[2] = {e.sinc, d[0] * e.versine};
  double step[2], moved[2];
  so2_rotate(arc, d + 1, step);
  so2_rotate(x, step, moved);
  const double px = x[2] + moved[0], py = x[3] + moved[1];
  so2_retract(x, d[0], out);
  out[2] = px;
  out[3] = py;
}

}  // namespace
}  // namespace heliograph::lie
