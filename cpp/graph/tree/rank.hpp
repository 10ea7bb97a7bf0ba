// SPDX-License-Identifier: MIT
// Pivots that are only what rounding left of zero: the normal equations are singular, although Cholesky runs through.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/plan.hpp"
#include "graph/tree/cliques.hpp"

namespace heliograph {

// Fronts of a plan that were eliminated, and the orphans that follow them as elements.
struct FrontBlocks {
  const Plan& plan;
  std::span<double* const> factor;  // pivot columns of each front
  std::span<const int32_t> orphans;
  const TreeCliques& cliques;
};

// Returns the first vanished pivot (scalar) of an eliminated front, or -1. `diagonal` is what the fronts' own factors gave, in
// elimination order. At a root, where a free motion of the whole shows, what the fronts below have taken counts as well: it may
// have left only rounding errors.
int vanished_pivot(const FrontBlocks& blocks, size_t front, std::span<const double> diagonal);

}  // namespace heliograph
