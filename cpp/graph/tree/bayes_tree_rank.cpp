// SPDX-License-Identifier: MIT
// Pivots that are only what rounding left of zero: the normal equations are singular, although Cholesky runs through.
#include <algorithm>
#include <vector>

#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

// A pivot below this part of what it was summed from has no correct digit left.
constexpr double kVanished = 1e-14;

}  // namespace

// Returns the first vanished pivot of an eliminated front, or -1. `diagonal` is what the front's own factors gave. At a root, where
// a free motion of the whole shows, what the fronts below have taken counts as well: it may have left only rounding errors.
int BayesTree::vanished(const Plan& plan, size_t index, const std::vector<double*>& factor, std::span<const double> diagonal) const {
  const FrontView& front = plan.fronts[index];
  const size_t elements = plan.fronts.size() - orphans_.size();  // where those that were eliminated before begin
  std::vector<double> magnitude(diagonal.begin() + front.first_pivot, diagonal.begin() + front.first_pivot + front.pivots);
  for (int32_t c = front.rows == 0 ? front.child_begin : front.child_end; c < front.child_end; ++c) {
    const auto child = static_cast<size_t>(plan.children[static_cast<size_t>(c)]);
    const FrontView& below = plan.fronts[child];
    const bool made = child < elements;
    const Clique* orphan = made ? nullptr : &cliques_[static_cast<size_t>(orphans_[child - elements])];
    const int32_t pivots = made ? below.pivots : orphan->pivots, height = made ? below.height : orphan->height;
    const double* columns = made ? factor[child] : orphan->factor;
    for (int32_t r = 0; r < below.runs; ++r) {
      const RunView& run = plan.runs[static_cast<size_t>(below.run_begin + r)];
      for (int32_t k = 0; k < pivots; ++k)
        for (int32_t i = 0; i < run.count; ++i) {
          const double l = columns[static_cast<int64_t>(k) * height + pivots + run.from + i];
          magnitude[static_cast<size_t>(run.to + i)] += l * l;
        }
    }
  }
  for (int32_t k = 0; k < front.pivots; ++k) {
    const double l = factor[index][static_cast<int64_t>(k) * front.height + k];
    if (!(l * l > kVanished * magnitude[static_cast<size_t>(k)])) return k;
  }
  return -1;
}

}  // namespace heliograph
