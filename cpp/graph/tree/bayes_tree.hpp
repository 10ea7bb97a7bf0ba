// SPDX-License-Identifier: MIT
// The Bayes tree (Kaess et al. 2012): the factorised graph as a tree of cliques, of which an update makes only the top again.
// Everything is addressed by flat indices; cliques keep their dense blocks in pooled memory.
//
// Two kinds of clique are not the paper's. One without pivots is a summary: what variables that were marginalised out said
// about its rows, a linear factor at their linearisation point, which is kept from then on. And while an elimination is worked
// through in slices the tree is open: its finished cliques are a forest, whose roots stand among the orphans.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "graph/tree/archive.hpp"
#include "graph/tree/counts.hpp"
#include "graph/tree/covariance.hpp"
#include "graph/tree/elimination.hpp"
#include "graph/tree/journal.hpp"
#include "graph/tree/marginal.hpp"
#include "graph/tree/steps.hpp"
#include "graph/tree/store.hpp"
#include "graph/tree/top.hpp"

namespace heliograph {

// What one pass over the tree may do.
struct PassLimits {
  double threshold = 0.0;       // as `relinearize` takes them
  size_t relinearize = 0;       // variables; none is looked for where it is zero
  bool farthest_first = false;
  size_t eliminate = 0;         // variables
  StepLimits steps;
};

struct PassReport {
  size_t relinearized = 0;
  size_t caught_up = 0;        // variables of deferred steps that were computed
  int32_t undetermined = -1;   // as `eliminate` returns it
  std::array<double, 5> seconds{};  // relinearize, detach, reorder, eliminate, solve
};

// The store holds the tree between updates; the journal an update's changes; the top what it took down; the elimination makes
// its fronts; the steps are carried down; the marginal cuts leaves off. An update is, in this order: add, remove, weigh,
// relinearize, detach, set_custom, reorder, eliminate, solve; or `undo` at any point before `eliminate` has ended.
class BayesTree {
 public:
  BayesTree() : top_(store_), journal_(store_), elimination_(store_, journal_, top_), steps_(store_), marginal_(store_) {}
  BayesTree(const BayesTree&) = delete;
  BayesTree& operator=(const BayesTree&) = delete;

  // --- what an update brings ---
  std::vector<int32_t> add_variables(Manifold manifold, int dof, std::span<const double> packed) {  // returns their numbers
    return journal_.add_variables(manifold, dof, packed);
  }
  void hold(std::span<const int32_t> fresh) { journal_.hold(fresh); }  // at the values that they came with
  int32_t add_kind(const FactorKind& kind) { return store_.factors.add_kind(kind); }
  std::vector<int32_t> add_factors(int32_t kind, std::span<const int32_t> variables, std::span<const double> measurement,
                                   std::span<const double> sqrt_information, bool let_go) {
    return journal_.add_factors(kind, variables, measurement, sqrt_information, let_go);
  }
  void remove_factors(std::span<const int32_t> factors) { journal_.remove_factors(factors); }
  bool has_factors(std::span<const int32_t> factors) const { return store_.factors.has(factors); }
  void weigh_factors(std::span<const int32_t> factors, std::span<const double> weights) { journal_.weigh_factors(factors, weights); }

  // Factors that keep their numbers and say nothing, as those that come with `let_go`; and such as speak again.
  void let_go(std::span<const int32_t> factors) { journal_.let_go(factors); }
  void take_back(std::span<const int32_t> factors) { journal_.take_back(factors); }

  // --- one update, step by step ---
  // Variables whose step is longer than the threshold take it into their linearisation point; returns how many. At most
  // `max`: the farthest first, or those first that were found first, which lie near each other in the tree.
  size_t relinearize(double threshold, size_t max, bool farthest_first);
  // Looks through all variables for steps longer than the threshold, where it is lower than that of the last solve.
  void find_fluid(double threshold) { store_.variables.find_fluid(threshold); }
  // Takes down every clique on the way from a touched variable to the root.
  void detach();
  // Custom factors of a kind that have to be linearised, and what the caller evaluated for them.
  std::vector<int32_t> stale_factors(int32_t kind) const;
  void set_custom(std::span<const int32_t> factors, std::span<const double> residual,
                  const std::vector<std::span<const double>>& jacobians) {
    store_.factors.set_custom(factors, residual, jacobians);
  }
  void reorder() { elimination_.reorder(); }  // what was taken down: the newest last
  // Eliminates it, with what hangs below it: at most about `max` variables, whole fronts and at least one; the tree is then
  // open until later calls have done the rest. Returns the variable at which the normal equations are not positive definite
  // (the tree is then as before), or -1.
  int32_t eliminate(size_t max);
  // All of these and `solve` in one, where no custom factor has to be evaluated between them.
  PassReport advance(const PassLimits& limits);
  // Undoes everything since the last update ended: the tree is as it was then, to the bit.
  void undo();
  size_t solve(const StepLimits& limits);  // returns how many of the variables solved were deferred before
  void finish_steps() { counts_.solved += steps_.finish(); }  // all that was deferred

  // --- what leaves ---
  // Marks variables: the next elimination takes them first, then `drop_left` forgets them. Not while the tree is open.
  void leave(std::span<const int32_t> variables);
  std::vector<int32_t> drop_left() { return marginal_.drop(steps_.keep()); }  // returns the factors that are summarised

  // --- what it says ---
  const TreeCounts& counts() const { return counts_; }
  size_t variables() const { return store_.variables.count(); }
  size_t slots() const { return store_.variables.slots(); }  // numbers below this are, or were, variables
  size_t cliques() const { return store_.cliques.count(); }
  size_t factors() const { return store_.factors.count(); }
  size_t waiting() const { return top_.waiting(); }     // variables that are not eliminated yet
  size_t fluid() const { return store_.variables.fluid().size(); }  // candidates for relinearisation
  double longest_fluid() const { return store_.variables.longest_fluid(); }
  size_t deferred() const { return steps_.deferred(); }  // branches whose steps are old
  bool idle() const { return journal_.idle(); }          // no update is under way
  bool held(int32_t variable) const;
  std::vector<int32_t> factors_of(int32_t variable) const;  // in the tree, ascending; none of a held variable
  std::vector<double> estimate(std::span<const int32_t> variables);  // packed, one after another; never an old step
  std::vector<double> linearization_point(std::span<const int32_t> variables) const;
  std::span<const double> theta() const { return store_.variables.all_theta(); }
  std::span<const double> delta() const { return store_.variables.all_delta(); }
  double largest_step() const { return store_.variables.largest_step(); }
  GroupCost cost() const;  // of all factors at the estimate, but those that are let go
  // One factor of weight one without kernel, and its variables.
  std::pair<std::vector<int32_t>, FactorGroup> factor_alone(int32_t factor) const;
  uint32_t solves() const { return steps_.solves(); }  // so far
  // Squared whitened residuals at the estimate, -1 where no variable has moved since a solve.
  std::vector<double> squared(std::span<const int32_t> factors, uint32_t since);
  // How far each factor is from what all others say, and what of that is left when it has its say: two numbers each, see
  // `Innovation`.
  std::vector<double> innovations(std::span<const int32_t> factors);
  std::vector<double> covariance(std::span<const int32_t> variables) const;        // see `TreeCovariance`
  std::vector<double> joint_covariance(std::span<const int32_t> variables) const;
  const std::vector<int32_t>& made() const { return steps_.made(); }  // cliques of the last update
  const std::vector<Clique>& all_cliques() const { return store_.cliques.all(); }
  const std::vector<FactorGroup>& all_kinds() const { return store_.factors.kinds(); }
  const std::vector<TreeFactor>& all_factors() const { return store_.factors.all(); }
  std::pair<Manifold, int> family(int32_t variable) const {
    return {store_.variables.manifold(variable), store_.variables.dof(variable)};
  }
  size_t bytes() const { return store_.variables.bytes() + store_.factors.bytes() + store_.cliques.bytes(); }

  // The whole state between updates as bytes, and back.
  std::vector<uint8_t> save() const;
  void load(std::span<const uint8_t> bytes);

 private:
  void check_slots(std::span<const int32_t> variables) const;
  StoredTree stored();

  TreeStore store_;
  TreeTop top_;
  TreeJournal journal_;
  TreeElimination elimination_;
  TreeSteps steps_;
  TreeMarginal marginal_;
  TreeCounts counts_;
};

}  // namespace heliograph
