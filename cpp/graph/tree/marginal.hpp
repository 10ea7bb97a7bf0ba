// SPDX-License-Identifier: MIT
// Variables that leave: they are eliminated first, which makes them leaves of the tree; then the leaves are cut off, and what
// they handed to their parents stays as a summary.
//
// A summary is linear about the linearisation points that its variables had then. Those points are kept from then on, so that
// every factor of these variables is linearised where the summary was (first estimates): were they moved, summary and factors
// would disagree about which directions the measurements leave free, and certainty would be gained that nothing measured.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/tree/journal.hpp"
#include "graph/tree/store.hpp"
#include "graph/tree/top.hpp"

namespace heliograph {

class TreeMarginal {
 public:
  explicit TreeMarginal(TreeStore& store) : store_(store) {}

  // Marks variables that leave with the next elimination, which takes them first. The caller sees to it that no update is
  // under way.
  void leave(std::span<const int32_t> variables, TreeJournal& journal, TreeTop& top);
  // Forgets them, `made` being the cliques of that elimination; returns the factors that are summarised from now on.
  std::vector<int32_t> drop(std::span<const int32_t> made);
  void give_up() { leaving_.clear(); }  // the elimination failed: all stay

 private:
  void forget_below(int32_t clique, std::vector<int32_t>& dropped);
  void summarize(int32_t clique);
  void merge_summary(int32_t clique);

  TreeStore& store_;
  std::vector<int32_t> leaving_;
};

}  // namespace heliograph
