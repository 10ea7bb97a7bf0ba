// SPDX-License-Identifier: MIT
// A registered sweep as a measurement of motion, mounting and clock, and the prior of mounting and clock.
#pragma once
#include "factors/sensor_codes.hpp"
#include "graph/factors/residuals_pose.inl"

namespace heliograph {
namespace {

// Log(Z^-1 X(c) E), with X carried along its rate and velocity by c = offset + span drift. The measurement is Z, the rate
// and the span; docs/theory/calibration.md, eq. (3).
struct LidarPose {
  using Layout = Fixed<6, 9, 6, 2>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *X = value_of(v, k, 3, 0), *E = value_of(v, k, 3, 1), *clock = value_of(v, k, 3, 2);
    const double *Z = measurement_of(v, k, 16), *omega = Z + 12;
    const double later = clock[0] + Z[15] * clock[1], turn[3] = {later * omega[0], later * omega[1], later * omega[2]};
    const lie::ExpTerms e = lie::exp_terms(lie::dot3(turn, turn));
    double step[9], moved[12], seen[12], error[12], arm[3];
    lie::quadratic3(turn, e.sinc, e.versine, step);
    lie::multiply3(X, step, moved);
    for (int i = 0; i < 3; ++i) moved[9 + i] = X[9 + i] + later * X[12 + i];
    lie::multiply3(moved, E, seen);
    lie::so3_rotate(moved, E + 9, arm);
    for (int i = 0; i < 3; ++i) seen[9 + i] = moved[9 + i] + arm[i];
    lie::motion_between<1>(Z, seen, error);
    const lie::RotationLog log = lie::motion_log<1>(error, r);
    if constexpr (!kJacobian) return;
    double J[9], C[9];
    lie::so3_right_jacobian_inverse(r, log.h, J);
    lie::unroll3_jacobian(r, log, error + 9, J, C);
    put3(W, layout.stride(), 0, 9, J);
    put3(W, layout.stride(), 3, 9, C);
    put3(W, layout.stride(), 3, 12, J);
    by_motion(X, E, moved, step, omega, Z[15], later, J, C, layout.stride(), W);
  }

  // With Ad(E^-1) = [R' 0; -R' hat(t) R'] the pose enters by P = [J R' 0; C R' - J R' hat(t)  J R'].
  HELIOGRAPH_INLINE void by_motion(const double* X, const double* E, const double* moved, const double* step, const double* omega,
                                   double span, double later, const double* J, const double* C, int stride, double* W) {
    double JR[9], low[9], turned[9], back[9], velocity[3], by_time[6], part[3];
    lie::multiply3_transposed(J, E, JR);
    lie::multiply3_transposed(C, E, low);
    lie::multiply3_hat(JR, E + 9, turned);
    for (int i = 0; i < 9; ++i) low[i] -= turned[i];
    lie::multiply3_transposed(JR, step, back);
    put3(W, stride, 0, 0, back);
    put3(W, stride, 3, 3, back);
    put3(W, stride, 3, 6, back, later);
    lie::multiply3_transposed(low, step, back);
    put3(W, stride, 3, 0, back);
    lie::so3_rotate_back(moved, X + 12, velocity);
    lie::so3_rotate(JR, omega, by_time);
    lie::so3_rotate(low, omega, by_time + 3);
    lie::so3_rotate(JR, velocity, part);
    for (int i = 0; i < 3; ++i) by_time[3 + i] += part[i];
    for (int i = 0; i < 6; ++i) {
      W[i * stride + 15] = by_time[i];
      W[i * stride + 16] = span * by_time[i];
    }
  }
};

// (phi, l - l0, clock - clock0) with R = exp(phi) R0: about and along the axes that the mounting is given in.
struct CalibrationPrior {
  using Layout = Fixed<8, 6, 2>;
  template <bool kJacobian>
  HELIOGRAPH_INLINE void evaluate(const FactorView& v, const Layout& layout, size_t k, double* r, double* W) {
    const double *E = value_of(v, k, 2, 0), *clock = value_of(v, k, 2, 1), *E0 = measurement_of(v, k, 14);
    double turned[9];
    lie::multiply3_transposed(E, E0, turned);
    const lie::RotationLog log = lie::so3_log(turned, r);
    for (int i = 0; i < 3; ++i) r[3 + i] = E[9 + i] - E0[9 + i];
    for (int i = 0; i < 2; ++i) r[6 + i] = clock[i] - E0[12 + i];
    if constexpr (!kJacobian) return;
    double left[9], by_turn[9];
    lie::quadratic3(r, -0.5, log.h, left);
    lie::multiply3(left, E, by_turn);
    put3(W, layout.stride(), 0, 0, by_turn);
    put3(W, layout.stride(), 3, 3, E);
    for (int i = 0; i < 2; ++i) W[(6 + i) * layout.stride() + 6 + i] = 1.0;
  }
};

}  // namespace
}  // namespace heliograph
