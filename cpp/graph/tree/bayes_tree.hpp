// SPDX-License-Identifier: MIT
// The Bayes tree (Kaess et al. 2012): the factorised graph as a tree of cliques, of which an update re-makes only the top.
// Everything is addressed by flat indices; cliques keep their dense blocks in pooled memory.
//
// Two kinds of clique are not the paper's. One without pivots is a summary: what variables that were marginalised out said
// about its rows, a linear factor at their linearisation point, which is kept from then on. And while an elimination is worked
// through in slices the tree is open: its finished cliques are a forest, whose roots stand among the orphans.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/block_pool.hpp"
#include "graph/factors/factor_group.hpp"
#include "graph/cholesky/front_view.hpp"
#include "graph/cholesky/plan.hpp"
#include "graph/ordering/supernodes.hpp"

namespace heliograph {

// P(pivots | rows): the pivot columns of an eliminated front, and the remainder that it handed to its parent.
struct Clique {
  int32_t parent = -1;
  int32_t child = -1;        // first of its children
  int32_t next = -1;         // siblings
  int32_t previous = -1;
  int32_t pivot_nodes = 0;
  int32_t first_factor = -1; // of those that were assembled here
  int32_t pivots = 0;        // scalars
  int32_t rows = 0;
  int32_t height = 0;
  int32_t update_height = 0;
  uint32_t flagged = 0;      // number of the update that takes it down
  uint8_t unsolved = 0;      // made since the last solve
  uint8_t deferred = 0;      // its step and all below it were put off
  uint32_t solved = 0;       // number of the solve that computed its step
  std::vector<int32_t> nodes;  // variables: pivots, then rows, in the order of elimination
  double* factor = nullptr;
  double* update = nullptr;
};

struct TreeFactor {
  int32_t kind = -1;
  int32_t index = 0;     // in its kind
  int32_t clique = -1;
  int32_t next = -1;     // in its clique's list
  double* block = nullptr;
  uint8_t stale = 0;     // has to be linearised
  uint8_t removed = 0;   // by the update that is under way
};

struct TreeCounts {
  size_t variables = 0;  // eliminated anew
  size_t cliques = 0;    // taken down
  size_t factors = 0;    // assembled anew
  size_t linearized = 0;
  size_t solved = 0;     // variables whose step was computed
  double work = 0.0;     // multiplications of the elimination
};

class BayesTree {
 public:
  BayesTree();
  BayesTree(const BayesTree&) = delete;
  BayesTree& operator=(const BayesTree&) = delete;

  // --- what the tree is of ---
  std::vector<int32_t> add_variables(Manifold manifold, int dof, std::span<const double> packed);  // returns their numbers
  // Holds variables that no update has seen yet at their values.
  void hold(std::span<const int32_t> variables);
  int32_t add_kind(FactorType type, std::span<const int32_t> manifolds, std::span<const int32_t> dofs, int rows, NoiseForm noise,
                   KernelType kernel, double width);
  std::vector<int32_t> add_factors(int32_t kind, std::span<const int32_t> variables, std::span<const double> measurement,
                                   std::span<const double> sqrt_information);
  void remove_factors(std::span<const int32_t> factors);
  bool has_factors(std::span<const int32_t> factors) const;
  void weigh_factors(std::span<const int32_t> factors, std::span<const double> weights);

  // --- one update, step by step ---
  // Variables whose step is longer than the threshold take it into their linearisation point; returns how many.
  // At most so many: the farthest first, or those first that were found first, which lie near each other in the tree.
  size_t relinearize(double threshold, size_t most, bool farthest_first);
  // Looks through all variables for steps longer than the threshold, where it is lower than the one that `solve` was told.
  void find_fluid(double threshold);
  // Takes down every clique on the way from a touched variable to the root.
  void detach();
  // Custom factors of a kind that have to be linearised, and what the caller evaluated for them.
  std::vector<int32_t> stale_factors(int32_t kind) const;
  void set_custom(std::span<const int32_t> factors, std::span<const double> residual,
                  const std::vector<std::span<const double>>& jacobians);
  // Orders what was taken down: the newest last. Eliminates it, with what hangs below it. Returns the variable at which the
  // normal equations are not positive definite (the tree is then as before), or -1.
  void reorder();
  // At most about `most` variables, whole fronts and at least one; the tree is then open until later calls have done the rest.
  int32_t eliminate(size_t most);
  // Undoes everything since the last update ended: the tree is as it was then, to the bit.
  void undo() { roll_back(); }
  // Steps from the root down, as far as they change by more than `wildfire`; beyond about `most` variables they are put off.
  // Of what was put off before, `later` are done within the same limit. Returns how many of those were.
  size_t solve(double wildfire, double relinearize_threshold, size_t most, size_t later);
  void finish_steps();  // all that was put off

  // --- what leaves ---
  // Marks variables: the next elimination takes them first, then `drop_left` forgets them. Not while the tree is open.
  void leave(std::span<const int32_t> variables);
  std::vector<int32_t> drop_left();  // returns the factors that are summarised from now on

  const TreeCounts& counts() const { return counts_; }

  // --- what it says ---
  size_t variables() const { return dof_.size() - free_count_; }
  size_t slots() const { return dof_.size(); }  // numbers below this are, or were, variables
  size_t waiting() const { return open_ ? affected_.size() : 0; }  // variables that are not eliminated yet
  bool held(int32_t variable) const { return held_.at(static_cast<size_t>(variable)) != 0; }
  size_t cliques() const { return cliques_.size() - free_cliques_.size(); }
  size_t factors() const { return factors_.size() - free_factors_.size(); }
  std::vector<double> estimate(std::span<const int32_t> variables);  // packed, one after another; never an old step
  std::vector<double> linearization_point(std::span<const int32_t> variables) const;
  size_t fluid() const { return fluid_.size(); }
  size_t deferred() const { return deferred_.size(); }
  bool pending() const { return !fluid_.empty(); }  // steps longer than the last threshold
  bool idle() const { return touched_.empty() && relinearized_.empty() && fresh_.empty(); }
  std::span<const double> theta() const { return theta_; }
  std::span<const double> delta() const { return delta_; }
  double largest_step() const;
  GroupCost cost() const;         // of all factors at the estimate
  size_t bytes() const;
  // Covariances at the linearisation point: of each variable, blocks one after another; or of all of them together (D, D).
  std::vector<double> covariance(std::span<const int32_t> variables) const;
  std::vector<double> joint_covariance(std::span<const int32_t> variables) const;
  // The whole state between updates as bytes, and back; both go through the same list of members.
  std::vector<uint8_t> save() const;
  void load(std::span<const uint8_t> bytes);
  const std::vector<int32_t>& made() const { return made_; }  // cliques of the last update
  const std::vector<Clique>& all_cliques() const { return cliques_; }
  const std::vector<int32_t>& clique_of() const { return clique_of_; }

 private:
  static constexpr uint8_t kLeaving = 4;  // of a touched variable's flag; 1: new factors speak of it, 2: linearised anew

  struct Saved {  // of a relinearised variable, in case the update fails
    int32_t variable;
    std::vector<double> theta, delta;
  };

  struct OldFactor {  // what a factor was, in case the update fails
    int32_t factor;
    double weight;
  };

  void touch(int32_t variable);
  void flag_up(int32_t clique);
  void flag_with(int32_t variable);
  void unlink(int32_t clique);
  void link(int32_t clique, int32_t parent);
  void linearize_stale(const Plan* plan, size_t done);
  Elements elements() const;
  Adjacency adjacency(const Elements& elements, std::span<const int32_t> position) const;
  struct Rest {  // of an elimination that is not done yet
    std::vector<int32_t> affected, orphans, open_factors;
  };

  bool keep_order();
  Plan plan_elimination() const;
  size_t front_of(const Plan& plan, const TreeFactor& factor) const;
  void give_back(const Plan& plan, size_t done, const std::vector<double*>& factor, const std::vector<double*>& update);
  size_t slice_of(const Plan& plan, size_t made, size_t most) const;
  int32_t run(const Plan& plan, size_t done, std::vector<double*>& factor, std::vector<double*>& update);
  int32_t undetermined_fresh();
  void number_affected();
  void swap_rest(Rest& rest);
  void commit(const Plan& plan, const std::vector<double*>& factor, const std::vector<double*>& update, size_t done);
  void make_cliques(const Plan& plan, const std::vector<double*>& factor, const std::vector<double*>& update, size_t done);
  void place_open_factors(const Plan& plan, size_t done, Rest& rest);
  void shrink(size_t variables);
  void restore(const std::vector<Saved>& saved);
  void restore_factors();
  void free_variable(int32_t variable);
  void summarize(int32_t clique);
  void forget_below(int32_t clique, std::vector<int32_t>& dropped);
  void merge_summary(int32_t clique);
  void freeze(int32_t variable);
  int vanished(const Plan& plan, size_t front, const std::vector<double*>& factor, std::span<const double> diagonal) const;
  void roll_back();
  void finish_update();
  void drop_factor(int32_t factor);
  double longest_element(int32_t variable) const;
  int32_t new_clique();
  void release(int32_t clique);
  template <typename StepOf>
  void compute_step(const Clique& clique, StepOf&& step_of, std::vector<double>& rows, std::vector<double>& step) const;
  void solve_clique(int32_t clique);
  bool rows_changed(const Clique& clique) const;
  void carry_down(std::vector<int32_t>& stack, size_t most);
  void catch_up(size_t most);
  std::vector<double> step_of(int32_t variable) const;
  template <typename Archive>
  void archive(Archive& with);
  void check_loaded() const;

  // Variables.
  std::vector<Manifold> manifold_;
  std::vector<int32_t> dof_;
  std::vector<int64_t> theta_at_, delta_at_;
  std::vector<int32_t> clique_of_;
  std::vector<double> theta_, delta_;
  std::vector<uint32_t> changed_;   // number of the solve in which its step last changed
  std::vector<uint8_t> fluid_flag_, held_;
  std::vector<uint8_t> frozen_;     // a summary speaks of it: its linearisation point stays
  std::vector<std::vector<int32_t>> free_variables_;  // by family
  size_t free_count_ = 0;
  std::vector<int32_t> fluid_;      // candidates for relinearisation

  // Factors.
  std::vector<FactorGroup> kinds_;
  std::vector<std::vector<int32_t>> free_rows_;
  std::vector<TreeFactor> factors_;
  std::vector<int32_t> free_factors_;
  BlockPool factor_blocks_;

  // Cliques.
  std::vector<Clique> cliques_;
  std::vector<int32_t> free_cliques_;
  std::vector<int32_t> roots_;
  BlockPool clique_blocks_;
  FrontKernels kernels_;
  std::vector<double> scratch_;

  // The update that is under way.
  uint32_t update_number_ = 1;
  uint32_t solve_number_ = 0;
  std::vector<uint8_t> touched_flag_;
  std::vector<int32_t> touched_;        // by new or removed factors
  std::vector<int32_t> relinearized_;
  std::vector<Saved> saved_;
  std::vector<OldFactor> old_, weighed_;
  std::vector<double> old_blocks_;      // of old_, one after another
  std::vector<int32_t> fluid_before_;
  bool looked_at_fluid_ = false;
  std::vector<int32_t> fresh_;          // variables not in the tree yet
  std::vector<int32_t> loose_;          // factors not in the tree yet
  std::vector<int32_t> removed_;        // factors that leave it
  std::vector<int32_t> taken_, orphans_, affected_, open_factors_, order_;
  std::vector<int32_t> local_;          // number of a variable among the affected
  bool open_ = false;                   // between two slices
  bool indivisible_ = false;            // factors were removed or weighed: done in one go, so that it can be undone
  bool detached_ = false;
  size_t grown_ = 0;                    // fresh variables whose numbers are new
  size_t eliminated_ = 0;               // variables, since the last solve
  std::vector<Saved> job_saved_;        // as saved_, by the earlier slices of an elimination
  std::vector<int32_t> kept_order_;     // of the variables that wait
  Rest carried_;                        // the open part, as it was when this update began
  std::vector<int32_t> undo_;           // variables whose linearisation point was put back while the tree was open
  std::vector<int32_t> leaving_;
  std::vector<int32_t> made_, attached_;  // cliques of the last update, and those hung below them
  std::vector<int32_t> deferred_;         // topmost cliques whose steps were put off, the oldest first
  double wildfire_ = 0.0, fluid_threshold_ = 0.0;  // of the last solve
  std::vector<double> rows_, step_;
  TreeCounts counts_;
};

}  // namespace heliograph
