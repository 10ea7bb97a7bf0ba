// SPDX-License-Identifier: MIT
// The update that is under way: what it brings, what it changed in place, and so what has to be kept or undone.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/tree/store.hpp"

namespace heliograph {

// Until `commit` or `roll_back` the cliques are as the last update left them. What is changed in place (linearisation points,
// factor blocks, weights) is written down first, so that `roll_back` restores it to the bit.
//
// An elimination may be spread over several updates. The linearisation points that its first slice took are remembered until
// the last one is done: where a slice fails they are given up, and cliques made since then speak of them (`put_back`).
class TreeJournal {
 public:
  static constexpr uint8_t kTouched = 1, kRelinearized = 2, kLeaving = 4;  // marks of a variable

  explicit TreeJournal(TreeStore& store) : store_(store) {}

  std::vector<int32_t> add_variables(Manifold manifold, int dof, std::span<const double> packed);
  void hold(std::span<const int32_t> variables);  // of this update only
  std::vector<int32_t> add_factors(int32_t kind, std::span<const int32_t> scopes, std::span<const double> measurement,
                                   std::span<const double> sqrt_information, bool let_go);
  void remove_factors(std::span<const int32_t> factors);
  void weigh_factors(std::span<const int32_t> factors, std::span<const double> weights);
  void let_go(std::span<const int32_t> factors);
  void take_back(std::span<const int32_t> factors);  // that were let go before this update
  // Returns the variables whose linearisation point took the step in, see `TreeVariables::draw_fluid`.
  std::vector<int32_t> relinearize(double threshold, size_t max, bool farthest_first);
  void linearize(int32_t factor);
  void mark_leaving(int32_t variable);
  void mark_relinearized();  // those that were put back included

  bool idle() const { return touched_.empty() && relinearized_.empty() && fresh_.empty(); }
  // Factors were removed, weighed or let go: done in one go, so that it can be undone.
  bool indivisible() const { return indivisible_; }
  uint8_t marks(int32_t variable) const {
    const auto v = static_cast<size_t>(variable);
    return v < marks_.size() ? marks_[v] : uint8_t{0};
  }
  const std::vector<int32_t>& fresh() const { return fresh_; }  // variables not in the tree yet
  const std::vector<int32_t>& loose() const { return loose_; }  // factors not in the tree yet
  const std::vector<int32_t>& taken_back() const { return taken_back_; }
  const std::vector<int32_t>& touched() const { return touched_; }
  const std::vector<int32_t>& relinearized() const { return relinearized_; }
  const std::vector<int32_t>& put_back() const { return put_back_; }

  void commit(bool open);  // `open`: further slices follow
  // `open_factors` were taken out of their cliques; `in_slice`: an elimination that earlier updates began is given up.
  void roll_back(std::span<const int32_t> open_factors, bool in_slice);

  struct Stored {
    std::vector<int32_t>& put_back;
    std::vector<SavedVariable>& slice_saved;
  };
  Stored stored() { return {put_back_, slice_saved_}; }

 private:
  struct OldWeight {
    int32_t factor;
    double weight;
  };

  void mark(int32_t variable, uint8_t mark);
  void touch(int32_t variable);
  void touch_scope(int32_t factor);
  void restore_variables(bool in_slice);
  void restore_factors(std::span<const int32_t> open_factors);
  void clear();

  TreeStore& store_;
  std::vector<uint8_t> marks_;           // (variables); shorter where none was marked
  std::vector<int32_t> touched_;         // by new, removed or weighed factors
  std::vector<int32_t> relinearized_;
  std::vector<int32_t> fresh_, loose_, removed_, let_go_, taken_back_;
  std::vector<SavedVariable> saved_;
  std::vector<int32_t> old_factors_;     // linearised again
  std::vector<double> old_blocks_;       // theirs, one after another
  std::vector<OldWeight> old_weights_;
  std::vector<int32_t> old_fluid_;
  bool drew_fluid_ = false;
  bool indivisible_ = false;
  size_t new_slots_ = 0;                 // fresh variables whose numbers are new
  std::vector<SavedVariable> slice_saved_;  // as saved_, by the earlier slices of an elimination
  std::vector<int32_t> put_back_;        // variables whose linearisation point was given up by a failed slice
};

}  // namespace heliograph
