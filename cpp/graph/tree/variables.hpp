// SPDX-License-Identifier: MIT
// The variables of a Bayes tree: linearisation points, steps, and which of them wait to be relinearised.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/factors/manifold.hpp"

namespace heliograph {

// A variable's linearisation point and step, kept in case they have to be put back.
struct SavedVariable {
  int32_t variable;
  std::vector<double> theta, delta;
};

// Numbers are given again, by family, when a variable has left. A variable is in the list of fluid ones exactly when its flag
// says so, and never when it is frozen: a summary speaks of it, so its linearisation point stays.
class TreeVariables {
 public:
  TreeVariables();

  // Returns its number: one that was given back, or the next.
  int32_t take(Manifold manifold, int dof, const double* value);
  void give_back(int32_t variable);  // nothing speaks of it any more
  void truncate(size_t slots);       // the last numbers were never given

  size_t slots() const { return dof_.size(); }  // numbers below this are, or were, variables
  size_t count() const { return dof_.size() - free_count_; }
  bool has_slot(int32_t v) const { return v >= 0 && at(v) < dof_.size(); }

  Manifold manifold(int32_t v) const { return manifold_[at(v)]; }
  int dof(int32_t v) const { return dof_[at(v)]; }
  int storage(int32_t v) const { return storage_of(manifold_[at(v)], dof_[at(v)]); }
  const std::vector<int32_t>& dofs() const { return dof_; }
  const double* theta() const { return theta_.data(); }  // of all, one after another
  const double* theta(int32_t v) const { return theta_.data() + theta_at_[at(v)]; }
  int64_t theta_offset(int32_t v) const { return theta_at_[at(v)]; }
  const double* delta(int32_t v) const { return delta_.data() + delta_at_[at(v)]; }
  std::span<const double> all_theta() const { return theta_; }
  std::span<const double> all_delta() const { return delta_; }

  int32_t clique_of(int32_t v) const { return clique_of_[at(v)]; }
  void set_clique(int32_t v, int32_t clique) { clique_of_[at(v)] = clique; }
  bool held(int32_t v) const { return held_[at(v)] != 0; }
  void hold(int32_t v) { held_[at(v)] = 1; }
  void freeze(int32_t variable);

  // Step of a variable, and the number of the solve in which it last changed.
  uint32_t changed(int32_t v) const { return changed_[at(v)]; }
  void set_step(int32_t variable, const double* step, uint32_t solve_number);
  double longest_element(int32_t variable) const;
  double largest_step() const;  // of those whose linearisation point may move
  void retract(int32_t variable, const double* step, double* out) const;  // theta retracted by a step

  // Theta takes the step in, and the step becomes zero.
  void absorb_step(int32_t variable);
  SavedVariable saved(int32_t variable) const;
  void restore(const SavedVariable& saved);

  // Candidates for relinearisation.
  const std::vector<int32_t>& fluid() const { return fluid_; }
  double longest_fluid() const;  // element of their steps
  void set_fluid(std::vector<int32_t> fluid);
  void add_fluid(int32_t variable);
  void find_fluid(double threshold);  // looks through all variables
  // Takes those whose step is longer than the threshold off the list, at most `max`: the farthest, or those that were found
  // first, which lie near each other in the tree. Those whose step is no longer so are dropped on the way.
  std::vector<int32_t> draw_fluid(double threshold, size_t max, bool farthest_first);

  size_t bytes() const;

  // Which list of numbers that may be given again.
  static size_t family_of(Manifold manifold, int dof) {
    return static_cast<size_t>(static_cast<int>(manifold) * (kMaxDof + 1) + dof);
  }

  // What a file holds of it.
  struct Stored {
    std::vector<Manifold>& manifold;
    std::vector<int32_t>&dof, &clique_of, &fluid;
    std::vector<int64_t>&theta_at, &delta_at;
    std::vector<double>&theta, &delta;
    std::vector<uint32_t>& changed;
    std::vector<uint8_t>&fluid_flag, &held, &frozen;
    std::vector<std::vector<int32_t>>& free;
    size_t& free_count;
  };
  Stored stored() {
    return {manifold_, dof_,     clique_of_,  fluid_, theta_at_, delta_at_, theta_,
            delta_,    changed_, fluid_flag_, held_,  frozen_,   free_,     free_count_};
  }

 private:
  static size_t at(int32_t variable) { return static_cast<size_t>(variable); }

  std::vector<Manifold> manifold_;
  std::vector<int32_t> dof_;
  std::vector<int64_t> theta_at_, delta_at_;
  std::vector<int32_t> clique_of_;  // that eliminates it; -1: held, or not in the tree
  std::vector<double> theta_, delta_;
  std::vector<uint32_t> changed_;
  std::vector<uint8_t> fluid_flag_, held_, frozen_;
  std::vector<std::vector<int32_t>> free_;  // by family
  size_t free_count_ = 0;
  std::vector<int32_t> fluid_;
};

}  // namespace heliograph
