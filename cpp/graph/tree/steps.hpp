// SPDX-License-Identifier: MIT
// Steps, from the root of the Bayes tree down: only as far as they change (wildfire), and only a bounded number at once.
//
// A clique has to be solved where one of its rows has changed since it was solved last. What an update leaves undone is known
// by its topmost cliques, which wait in a queue; below them steps are old, consistently so, until their turn comes.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/front_view.hpp"
#include "graph/tree/kernels.hpp"
#include "graph/tree/store.hpp"

namespace heliograph {

// How far one solve goes.
struct StepLimits {
  double wildfire = 0.0;     // what moves by no more than this is not carried on [rad, m]
  double relinearize = 0.0;  // what is longer than this becomes a candidate for relinearisation [rad, m]
  size_t max = 0;            // variables, about; beyond, they are deferred
  size_t max_deferred = 0;   // variables of what was deferred before, within the same limit
};

struct StepCounts {
  size_t solved = 0;     // variables whose step was computed
  size_t caught_up = 0;  // of them, those that were deferred before
};

class TreeSteps {
 public:
  explicit TreeSteps(TreeStore& store) : store_(store), kernels_(front_kernels()) {}

  // Cliques that an elimination of some variables made, and the orphans hung below them: the next solve begins there.
  void expect(std::vector<int32_t> made, std::vector<int32_t> attached, size_t variables);
  // The expected cliques have the steps that they had: nothing has to be solved. Returns them.
  std::vector<int32_t> keep();
  StepCounts solve(const StepLimits& limits);
  size_t finish();  // all that was deferred; returns how many variables

  size_t deferred() const { return deferred_.size(); }
  uint32_t solves() const { return solve_number_; }
  const std::vector<int32_t>& made() const { return made_; }
  // Packed values, one after another; never by an old step.
  std::vector<double> estimate(std::span<const int32_t> variables);

  struct Stored {
    std::vector<int32_t>&made, &attached, &deferred;
    uint32_t& solve_number;
    size_t& eliminated;
    double &wildfire, &relinearize;
  };
  Stored stored() { return {made_, attached_, deferred_, solve_number_, eliminated_, wildfire_, relinearize_}; }

 private:
  template <typename StepOf>
  void compute(const Clique& clique, StepOf&& step_of, std::vector<double>& rows, std::vector<double>& step) const;
  void solve_clique(int32_t clique);
  bool rows_changed(const Clique& clique) const;
  bool due(const Clique& clique) const { return clique.pivot_nodes > 0 && (clique.unsolved != 0 || rows_changed(clique)); }
  void carry_down(std::vector<int32_t>& stack, size_t max);
  void catch_up(size_t max);
  std::vector<double> step_of(int32_t variable) const;

  TreeStore& store_;
  FrontKernels kernels_;
  uint32_t solve_number_ = 0;
  std::vector<int32_t> made_, attached_;
  size_t eliminated_ = 0;          // variables, since the last solve
  std::vector<int32_t> deferred_;  // topmost cliques of what is deferred, the oldest first
  double wildfire_ = 0.0, relinearize_ = 0.0;  // of the last solve
  size_t solved_ = 0;              // variables, by the solve that is under way
  std::vector<double> rows_, step_;
};

}  // namespace heliograph
