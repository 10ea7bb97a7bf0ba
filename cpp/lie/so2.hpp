// SPDX-License-Identifier: MIT
// Rotations in the plane as (cos, sin).
#pragma once
#include "lie/series.hpp"

namespace heliograph::lie {
namespace {

// A^T B, the rotation from a to b.
HELIOGRAPH_INLINE void so2_between(const double* a, const double* b, double* out) {
  const double c = a[0] * b[0] + a[1] * b[1], s = a[0] * b[1] - a[1] * b[0];
  out[0] = c;
  out[1] = s;
}

HELIOGRAPH_INLINE void so2_rotate(const double* r, const double* v, double* out) {
  const double x = r[0] * v[0] - r[1] * v[1], y = r[1] * v[0] + r[0] * v[1];
  out[0] = x;
  out[1] = y;
}

HELIOGRAPH_INLINE void so2_rotate_back(const double* r, const double* v, double* out) {
  const double x = r[0] * v[0] + r[1] * v[1], y = r[0] * v[1] - r[1] * v[0];
  out[0] = x;
  out[1] = y;
}

// An angle and g = (angle / 2) cot(angle / 2).
struct PlaneAngle {
  double angle, g;
};

[[gnu::noinline]] static PlaneAngle so2_log_far(double c, double s) {
  const double angle = std::atan2(s, c);
  const double cotangent = c < 0.0 ? s / (1.0 - c) : (1.0 + c) / s;  // of the half angle, without cancellation
  return {angle, 0.5 * angle * cotangent};
}

// Up to pi/4 by the tangent of the half angle, with which g comes for nothing.
HELIOGRAPH_INLINE PlaneAngle so2_log(double c, double s) {
  const double t = s / (1.0 + c), u = t * t;
  if (!(c > 0.0 && u <= kNearTangent2)) return so2_log_far(c, s);
  const double g = arc_over_tangent(u);
  return {2.0 * t * g, g};
}

// r <- r exp(angle), brought back to length 1.
HELIOGRAPH_INLINE void so2_retract(const double* r, double angle, double* out) {
  const double turn[2] = {std::cos(angle), std::sin(angle)};
  double next[2];
  so2_rotate(r, turn, next);
  const double scale = 1.0 / std::sqrt(next[0] * next[0] + next[1] * next[1]);
  out[0] = scale * next[0];
  out[1] = scale * next[1];
}

}  // namespace
}  // namespace heliograph::lie
