// SPDX-License-Identifier: MIT
#include "graph/tree/rank.hpp"

namespace heliograph {

namespace {

// A pivot below this part of what it was summed from has no correct digit left.
constexpr double kVanished = 1e-14;

struct Columns {
  const double* first;
  int32_t pivots, height;
};

Columns columns_of(const FrontBlocks& blocks, size_t front) {
  const size_t elements = blocks.plan.fronts.size() - blocks.orphans.size();  // where those that were eliminated before begin
  if (front < elements) return {blocks.factor[front], blocks.plan.fronts[front].pivots, blocks.plan.fronts[front].height};
  const Clique& orphan = blocks.cliques[blocks.orphans[front - elements]];
  return {orphan.factor, orphan.pivots, orphan.height};
}

}  // namespace

int vanished_pivot(const FrontBlocks& blocks, size_t index, std::span<const double> diagonal) {
  const Plan& plan = blocks.plan;
  const FrontView& front = plan.fronts[index];
  std::vector<double> magnitude(diagonal.begin() + front.first_pivot, diagonal.begin() + front.first_pivot + front.pivots);
  for (int32_t c = front.rows == 0 ? front.child_begin : front.child_end; c < front.child_end; ++c) {
    const auto child = static_cast<size_t>(plan.children[static_cast<size_t>(c)]);
    const FrontView& below = plan.fronts[child];
    const auto [columns, pivots, height] = columns_of(blocks, child);
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
    const double l = blocks.factor[index][static_cast<int64_t>(k) * front.height + k];
    if (!(l * l > kVanished * magnitude[static_cast<size_t>(k)])) return k;
  }
  return -1;
}

}  // namespace heliograph
