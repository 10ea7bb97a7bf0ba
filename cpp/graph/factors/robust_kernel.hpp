// SPDX-License-Identifier: MIT
// Robust costs of a whitened residual of squared length e2, as 2 rho(e) and the weight rho'(e) / e.
// Internal linkage: compiled once for each instruction set.
#pragma once
#include <cmath>

#include "graph/factors/factor_group.hpp"

namespace heliograph {
namespace {

struct Robust {
  double cost;    // 2 rho, e2 for small e
  double weight;  // 1 for small e
};

// With k the width and q = e2 / k^2. Tukey: k^2/3 (1 - (1 - q)^3). DCS (Agarwal et al. 2013, phi = k): the weight is s^2
// with s = min(1, 2 phi / (phi + e2)) and the cost its integral.
[[maybe_unused]] static inline Robust robust_of(KernelType kernel, double width, double e2) {
  const double k2 = width * width, q = e2 / k2;
  switch (kernel) {
    case KernelType::none: return {e2, 1.0};
    case KernelType::huber: {
      if (e2 <= k2) return {e2, 1.0};
      const double e = std::sqrt(e2);
      return {width * (2.0 * e - width), width / e};
    }
    case KernelType::cauchy: return {k2 * std::log1p(q), 1.0 / (1.0 + q)};
    case KernelType::geman_mcclure: {
      const double share = 1.0 / (1.0 + q);
      return {e2 * share, share * share};
    }
    case KernelType::tukey: {
      const double rest = q < 1.0 ? 1.0 - q : 0.0;
      return {q < 1.0 ? e2 * (1.0 - q + q * q / 3.0) : k2 / 3.0, rest * rest};
    }
    case KernelType::dcs: {
      if (e2 <= width) return {e2, 1.0};
      const double s = 2.0 * width / (width + e2);
      return {width * (3.0 - 2.0 * s), s * s};
    }
    case KernelType::truncated: return e2 <= k2 ? Robust{e2, 1.0} : Robust{k2, 0.0};
  }
  return {e2, 1.0};
}

}  // namespace
}  // namespace heliograph
