// SPDX-License-Identifier: MIT
#include "graph/tree/journal.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>

namespace heliograph {

namespace {

void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace

void TreeJournal::mark(int32_t variable, uint8_t mark) {
  const auto v = static_cast<size_t>(variable);
  if (v >= marks_.size()) marks_.resize(std::max(v + 1, store_.variables.slots()), 0);
  marks_[v] = static_cast<uint8_t>(marks_[v] | mark);
}

void TreeJournal::touch(int32_t variable) {
  if (marks(variable) != 0) return;
  mark(variable, kTouched);
  touched_.push_back(variable);
}

void TreeJournal::touch_scope(int32_t factor) {
  for (const int32_t v : store_.factors.scope(store_.factors[factor])) touch(v);
}

std::vector<int32_t> TreeJournal::add_variables(Manifold manifold, int dof, std::span<const double> packed) {
  const auto storage = static_cast<size_t>(storage_of(manifold, dof));
  require(dof > 0 && dof <= kMaxDof && storage > 0 && packed.size() % storage == 0, "values of another size");
  std::vector<int32_t> numbers;
  const size_t before = store_.variables.slots();
  for (size_t i = 0; i < packed.size(); i += storage)
    numbers.push_back(store_.variables.take(manifold, dof, packed.data() + i));
  new_slots_ += store_.variables.slots() - before;
  fresh_.insert(fresh_.end(), numbers.begin(), numbers.end());
  return numbers;
}

void TreeJournal::hold(std::span<const int32_t> variables) {
  for (const int32_t v : variables) {
    require(std::find(fresh_.begin(), fresh_.end(), v) != fresh_.end(), "only new variables can be held");
    store_.variables.hold(v);
  }
}

std::vector<int32_t> TreeJournal::add_factors(int32_t kind, std::span<const int32_t> scopes, std::span<const double> measurement,
                                              std::span<const double> sqrt_information, bool let_go) {
  std::vector<int32_t> added = store_.factors.add(kind, scopes, measurement, sqrt_information, store_.variables);
  for (const int32_t f : added) {
    store_.factors[f].let_go = let_go ? 1 : 0;
    if (!let_go) touch_scope(f);
  }
  loose_.insert(loose_.end(), added.begin(), added.end());
  return added;
}

void TreeJournal::remove_factors(std::span<const int32_t> numbers) {
  for (const int32_t f : numbers)
    require(store_.factors.has({&f, 1}) && store_.factors[f].removed == 0, "a factor that there is not");
  indivisible_ = indivisible_ || !numbers.empty();
  for (const int32_t f : numbers) {
    store_.factors[f].removed = 1;
    removed_.push_back(f);
    if (store_.factors[f].let_go == 0) touch_scope(f);
  }
}

void TreeJournal::weigh_factors(std::span<const int32_t> numbers, std::span<const double> weights) {
  require(numbers.size() == weights.size() && store_.factors.has(numbers), "one weight a factor that there is");
  indivisible_ = indivisible_ || !numbers.empty();
  for (size_t i = 0; i < numbers.size(); ++i) {
    old_weights_.push_back({numbers[i], store_.factors.set_weight(numbers[i], weights[i])});
    store_.factors[numbers[i]].stale = 1;
    touch_scope(numbers[i]);
  }
}

void TreeJournal::let_go(std::span<const int32_t> numbers) {
  for (const int32_t f : numbers)
    require(store_.factors.has({&f, 1}) && store_.factors[f].let_go == 0, "a factor that there is not, or that is let go");
  indivisible_ = indivisible_ || !numbers.empty();
  for (const int32_t f : numbers) {
    store_.factors[f].let_go = 1;
    let_go_.push_back(f);
    touch_scope(f);
  }
}

void TreeJournal::take_back(std::span<const int32_t> numbers) {
  for (const int32_t f : numbers)
    require(store_.factors.has({&f, 1}) && store_.factors[f].let_go != 0, "a factor that there is not, or that is not let go");
  indivisible_ = indivisible_ || !numbers.empty();
  for (const int32_t f : numbers) {
    store_.factors[f].let_go = 0;
    store_.factors[f].stale = 1;
    taken_back_.push_back(f);
    touch_scope(f);
  }
}

std::vector<int32_t> TreeJournal::relinearize(double threshold, size_t max, bool farthest_first) {
  old_fluid_ = store_.variables.fluid();
  drew_fluid_ = true;
  std::vector<int32_t> drawn = store_.variables.draw_fluid(threshold, max, farthest_first);
  for (const int32_t v : drawn) {
    saved_.push_back(store_.variables.saved(v));
    store_.variables.absorb_step(v);
    relinearized_.push_back(v);
  }
  return drawn;
}

void TreeJournal::linearize(int32_t number) {
  const TreeFactor& factor = store_.factors[number];
  if (factor.clique >= 0) {
    old_factors_.push_back(number);
    old_blocks_.insert(old_blocks_.end(), factor.block, factor.block + store_.factors.block_doubles(factor));
  }
  store_.factors.linearize(number, store_.variables.theta());
}

void TreeJournal::mark_leaving(int32_t variable) {
  touch(variable);
  mark(variable, kLeaving);
}

void TreeJournal::mark_relinearized() {
  relinearized_.insert(relinearized_.end(), put_back_.begin(), put_back_.end());
  for (const int32_t v : relinearized_) mark(v, kRelinearized);
}

void TreeJournal::commit(bool open) {
  for (const int32_t f : let_go_) store_.factors[f].clique = store_.factors[f].next = -1;
  for (const int32_t f : removed_) store_.factors.drop(f);
  slice_saved_.insert(slice_saved_.end(), std::make_move_iterator(saved_.begin()), std::make_move_iterator(saved_.end()));
  if (!open) slice_saved_.clear();
  put_back_.clear();
  clear();
}

void TreeJournal::roll_back(std::span<const int32_t> open_factors, bool in_slice) {
  restore_variables(in_slice);
  restore_factors(open_factors);
  const size_t slots = store_.variables.slots() - new_slots_;
  for (size_t i = fresh_.size(); i-- > 0;)
    if (static_cast<size_t>(fresh_[i]) < slots) store_.variables.give_back(fresh_[i]);
  store_.variables.truncate(slots);
  clear();
}

void TreeJournal::restore_variables(bool in_slice) {
  for (const SavedVariable& old : saved_) store_.variables.restore(old);
  if (drew_fluid_) store_.variables.set_fluid(std::move(old_fluid_));
  if (!in_slice) return;
  for (const SavedVariable& old : slice_saved_) {
    store_.variables.restore(old);
    store_.variables.add_fluid(old.variable);
    put_back_.push_back(old.variable);
  }
  slice_saved_.clear();
}

void TreeJournal::restore_factors(std::span<const int32_t> open_factors) {
  TreeFactors& factors = store_.factors;
  const double* from = old_blocks_.data();
  for (const int32_t f : old_factors_) {
    const size_t size = factors.block_doubles(factors[f]);
    std::copy_n(from, size, factors[f].block);
    from += size;
  }
  for (const int32_t f : open_factors)
    if (factors[f].clique >= 0) factors[f].stale = 0;  // the others stay open, and stale where no slice came to them yet
  for (size_t i = old_weights_.size(); i-- > 0;) {     // backwards: one may have been weighed twice
    const auto [f, weight] = old_weights_[i];
    factors.set_weight(f, weight);
    factors[f].stale = factors[f].clique >= 0 ? 0 : 1;
  }
  for (const int32_t f : removed_) factors[f].removed = 0;
  for (const int32_t f : let_go_) factors[f].let_go = 0;
  for (const int32_t f : taken_back_) factors[f].let_go = 1;
  for (size_t i = loose_.size(); i-- > 0;) factors.drop(loose_[i]);  // backwards: their numbers come again in the same order
}

void TreeJournal::clear() {
  for (const std::vector<int32_t>* list : {&touched_, &relinearized_})
    for (const int32_t v : *list)
      if (static_cast<size_t>(v) < marks_.size()) marks_[static_cast<size_t>(v)] = 0;
  for (std::vector<int32_t>* list : {&touched_, &relinearized_, &fresh_, &loose_, &removed_, &let_go_, &taken_back_, &old_factors_})
    list->clear();
  saved_.clear();
  old_blocks_.clear();
  old_weights_.clear();
  drew_fluid_ = indivisible_ = false;
  new_slots_ = 0;
}

}  // namespace heliograph
