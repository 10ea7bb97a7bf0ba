// SPDX-License-Identifier: MIT
// Trigonometric coefficients of the exponential maps at full double accuracy, near zero and far from it.
// All of cpp/lie has internal linkage: it is compiled into kernels of several instruction sets, which must not be merged.
#pragma once
#include <cmath>

#define HELIOGRAPH_INLINE [[gnu::always_inline]] static inline

namespace heliograph::lie {
namespace {

// c[0] + c[1] x + ... in two independent chains, which run side by side in the processor.
template <int N>
HELIOGRAPH_INLINE double polynomial(const double (&c)[N], double x) {
  const double x2 = x * x;
  double last = c[N - 1], before = c[N - 2];
  for (int k = N - 3; k >= 0; k -= 2) {
    last = last * x2 + c[k];
    if (k >= 1) before = before * x2 + c[k - 1];
  }
  return N % 2 == 1 ? last + x * before : before + x * last;
}

// tan(pi/8)^2: up to a rotation by pi/4 logarithms need no trigonometric function.
constexpr double kNearTangent2 = 0.17157287525380990;

// atan(t) / t from u = t^2 <= kNearTangent2; relative error 7e-18 before rounding (interpolated at Chebyshev nodes).
HELIOGRAPH_INLINE double arc_over_tangent(double u) {
  constexpr double kTerms[11] = {-0.3333333333333333,   0.1999999999999548,   -0.14285714284657894, 0.11111111014561013,
                                 -0.09090904549884611,  0.07692182535116648,  -0.06664502215671447, 0.058580687568615106,
                                 -0.05085030492810941,  0.03921955253255129,  -0.019162068915902573};
  return 1.0 + u * polynomial(kTerms, u);
}

// h(s) = (1 - (t/2) cot(t/2)) / t^2 and its derivative by s = t^2, for t <= pi/4.
HELIOGRAPH_INLINE double half_cotangent_defect_near(double s) {
  constexpr double kTerms[8] = {0.08333333333333333,   0.00138888888888889,  3.3068783068741526e-05, 8.267195772571213e-07,
                                2.087675357471714e-08, 5.28430766806653e-10, 1.3360173901992143e-11, 3.6098548674234954e-13};
  return polynomial(kTerms, s);
}

HELIOGRAPH_INLINE double half_cotangent_slope_near(double s) {
  constexpr double kTerms[8] = {0.001388888888888889,   6.613756613756641e-05, 2.4801587301491943e-06, 8.350702807485289e-08,
                                2.6420942861118096e-09, 8.029791519057056e-11, 2.367649779422236e-12,  7.372900831162677e-14};
  return polynomial(kTerms, s);
}

// From g = (t/2) cot(t/2), for t >= pi/4: nothing cancels there. h' = (1/8 - 3 h / 2 + s h^2 / 2) / s.
HELIOGRAPH_INLINE double half_cotangent_slope_far(double s, double h) { return (0.125 - 1.5 * h + 0.5 * s * h * h) / s; }

constexpr int kSeriesTerms = 11;
constexpr double kSeriesLimit = 2.25;  // of the squared angle: the closed forms lose less than two bits beyond

struct Series {
  double c[kSeriesTerms];
};

// (-1)^k / (2k + offset)!
constexpr Series alternating(int offset) {
  Series out{};
  for (int k = 0; k < kSeriesTerms; ++k) {
    double factorial = 1.0;
    for (int i = 2; i <= 2 * k + offset; ++i) factorial *= i;
    out.c[k] = (k % 2 == 0 ? 1.0 : -1.0) / factorial;
  }
  return out;
}

constexpr Series kSinc = alternating(1), kVersine = alternating(2), kCubic = alternating(3);

// sin(t) / t, (1 - cos(t)) / t^2 and (t - sin(t)) / t^3 from the squared angle.
struct ExpTerms {
  double sinc, versine, cubic;
};

static inline ExpTerms exp_terms(double s) {
  if (s < kSeriesLimit) return {polynomial(kSinc.c, s), polynomial(kVersine.c, s), polynomial(kCubic.c, s)};
  const double t = std::sqrt(s), sine = std::sin(t), half = std::sin(0.5 * t) / t;
  return {sine / t, 2.0 * half * half, (t - sine) / (t * s)};
}

}  // namespace
}  // namespace heliograph::lie
