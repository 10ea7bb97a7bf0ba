// SPDX-License-Identifier: MIT
// Orders and eliminates what an update took down, wholly or its first fronts.
#pragma once
#include <cstdint>
#include <vector>

#include "graph/cholesky/front_view.hpp"
#include "graph/tree/top.hpp"

namespace heliograph {

// What an elimination made: the blocks of a plan's first `done` fronts. The plan's last fronts are the orphans.
struct EliminatedFronts {
  Plan plan;
  size_t fronts = 0;                    // of the plan, without the orphans
  size_t done = 0;
  std::vector<double*> factor, update;  // (done), (all: made, then the orphans')
  size_t linearized = 0;                // factors
  int32_t undetermined = -1;            // the variable where the normal equations are not positive definite; no blocks then
};

class TreeElimination {
 public:
  TreeElimination(TreeStore& store, TreeJournal& journal, TreeTop& top);

  // Orders the top: what leaves first, the newest last.
  void reorder();
  // At most about `max` variables, whole fronts and at least one; all of them where the journal is indivisible.
  EliminatedFronts run(size_t max);
  // The order of what was not done, for the next slice.
  void keep_rest(const EliminatedFronts& eliminated);

  std::vector<int32_t>& stored_order() { return kept_order_; }

 private:
  bool continue_order();
  std::vector<int32_t> ordered(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> group) const;
  double flops_of(const Elements& elements, std::span<const int32_t> order) const;
  Plan plan() const;
  size_t linearize_all();
  size_t linearize_for(const Plan& plan, size_t done);
  size_t linearize(int32_t factor);
  int32_t eliminate(EliminatedFronts& out);
  int32_t undetermined_fresh(size_t& linearized);
  void give_back(const EliminatedFronts& eliminated, size_t done);

  TreeStore& store_;
  TreeJournal& journal_;
  TreeTop& top_;
  FrontKernels kernels_;
  std::vector<double> scratch_;
  std::vector<int32_t> order_;       // nodes of the top
  std::vector<int32_t> kept_order_;  // of the variables that wait
};

}  // namespace heliograph
