// SPDX-License-Identifier: MIT
#include <algorithm>

#include "graph/diagnosis/diagnosis.hpp"

namespace heliograph {

double least_pivot(const GraphProblem& problem) {
  const Plan& plan = problem.plan();
  const std::span<const double> factor = problem.factorization().factor(), diagonal = problem.factorization().diagonal();
  double least = 1.0;
  for (const FrontView& front : plan.fronts)
    for (int32_t c = 0; c < front.pivots; ++c) {
      const double pivot = factor[static_cast<size_t>(front.factor + int64_t{c} * front.height + c)];
      const double from = diagonal[static_cast<size_t>(front.first_pivot + c)];
      least = std::min(least, from > 0.0 ? pivot * pivot / from : 0.0);
    }
  return least;
}

}  // namespace heliograph
