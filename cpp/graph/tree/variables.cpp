// SPDX-License-Identifier: MIT
#include "graph/tree/variables.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace heliograph {

namespace {

constexpr int kFamilies = 7 * (kMaxDof + 1);

}  // namespace

TreeVariables::TreeVariables() : free_(static_cast<size_t>(kFamilies)) {}

int32_t TreeVariables::take(Manifold manifold, int dof, const double* value) {
  const auto storage = static_cast<size_t>(storage_of(manifold, dof));
  std::vector<int32_t>& free = free_[family_of(manifold, dof)];
  int32_t variable = static_cast<int32_t>(dof_.size());
  if (free.empty()) {
    manifold_.push_back(manifold);
    dof_.push_back(dof);
    theta_at_.push_back(static_cast<int64_t>(theta_.size()));
    delta_at_.push_back(static_cast<int64_t>(delta_.size()));
    theta_.resize(theta_.size() + storage);
    delta_.resize(delta_.size() + static_cast<size_t>(dof), 0.0);
    clique_of_.push_back(-1);
    changed_.push_back(0);
    for (std::vector<uint8_t>* flags : {&fluid_flag_, &held_, &frozen_}) flags->push_back(0);
  } else {
    variable = free.back();
    free.pop_back();
    --free_count_;
  }
  std::copy_n(value, storage, theta_.begin() + theta_at_[at(variable)]);
  return variable;
}

void TreeVariables::give_back(int32_t variable) {
  const size_t v = at(variable);
  if (std::exchange(fluid_flag_[v], uint8_t{0}) != 0) std::erase(fluid_, variable);
  std::fill_n(delta_.begin() + delta_at_[v], dof_[v], 0.0);
  clique_of_[v] = -1;
  changed_[v] = 0;
  held_[v] = frozen_[v] = 0;
  free_[family_of(manifold_[v], dof_[v])].push_back(variable);
  ++free_count_;
}

void TreeVariables::truncate(size_t slots) {
  if (slots < dof_.size()) {
    theta_.resize(static_cast<size_t>(theta_at_[slots]));
    delta_.resize(static_cast<size_t>(delta_at_[slots]));
  }
  dof_.resize(slots);
  clique_of_.resize(slots);
  for (std::vector<int64_t>* list : {&theta_at_, &delta_at_}) list->resize(slots);
  for (std::vector<uint8_t>* flags : {&fluid_flag_, &held_, &frozen_}) flags->resize(slots);
  manifold_.resize(slots);
  changed_.resize(slots);
}

void TreeVariables::freeze(int32_t variable) {
  frozen_[at(variable)] = 1;
  if (std::exchange(fluid_flag_[at(variable)], uint8_t{0}) != 0) std::erase(fluid_, variable);
}

void TreeVariables::set_step(int32_t variable, const double* step, uint32_t solve_number) {
  changed_[at(variable)] = solve_number;
  std::copy_n(step, dof_[at(variable)], delta_.begin() + delta_at_[at(variable)]);
}

double TreeVariables::longest_element(int32_t variable) const {
  const double* step = delta(variable);
  double longest = 0.0;
  for (int k = 0; k < dof(variable); ++k) longest = std::max(longest, std::abs(step[k]));
  return longest;
}

double TreeVariables::largest_step() const {
  double largest = 0.0;
  for (size_t v = 0; v < dof_.size(); ++v)  // a frozen one's step is no sign of an estimate that has yet to settle
    if (frozen_[v] == 0) largest = std::max(largest, longest_element(static_cast<int32_t>(v)));
  return largest;
}

void TreeVariables::retract(int32_t variable, const double* step, double* out) const {
  const FamilyBlock block{manifold_[at(variable)], dof(variable), storage(variable), 1, 0, 0, 0};
  retract_block(block, theta(variable), step, out);
}

void TreeVariables::absorb_step(int32_t variable) {
  double* point = theta_.data() + theta_at_[at(variable)];
  retract(variable, delta(variable), point);
  std::fill_n(delta_.begin() + delta_at_[at(variable)], dof_[at(variable)], 0.0);
}

SavedVariable TreeVariables::saved(int32_t variable) const {
  const double *point = theta(variable), *step = delta(variable);
  return {variable, {point, point + storage(variable)}, {step, step + dof(variable)}};
}

void TreeVariables::restore(const SavedVariable& saved) {
  std::copy(saved.theta.begin(), saved.theta.end(), theta_.begin() + theta_at_[at(saved.variable)]);
  std::copy(saved.delta.begin(), saved.delta.end(), delta_.begin() + delta_at_[at(saved.variable)]);
}

double TreeVariables::longest_fluid() const {
  double longest = 0.0;
  for (const int32_t v : fluid_) longest = std::max(longest, longest_element(v));
  return longest;
}

void TreeVariables::set_fluid(std::vector<int32_t> fluid) {
  for (const int32_t v : fluid_) fluid_flag_[at(v)] = 0;
  fluid_ = std::move(fluid);
  for (const int32_t v : fluid_) fluid_flag_[at(v)] = 1;
}

void TreeVariables::add_fluid(int32_t variable) {
  if (frozen_[at(variable)] == 0 && std::exchange(fluid_flag_[at(variable)], uint8_t{1}) == 0) fluid_.push_back(variable);
}

void TreeVariables::find_fluid(double threshold) {
  for (int32_t v = 0; has_slot(v); ++v)
    if (longest_element(v) > threshold) add_fluid(v);
}

std::vector<int32_t> TreeVariables::draw_fluid(double threshold, size_t max, bool farthest_first) {
  if (farthest_first && fluid_.size() > max)
    std::stable_sort(fluid_.begin(), fluid_.end(), [&](int32_t a, int32_t b) { return longest_element(a) > longest_element(b); });
  std::vector<int32_t> drawn;
  auto next = fluid_.begin();
  for (; next != fluid_.end() && drawn.size() < max; ++next) {
    const double length = longest_element(*next);
    fluid_flag_[at(*next)] = 0;
    if (length > threshold && length != 0.0) drawn.push_back(*next);
  }
  fluid_.erase(fluid_.begin(), next);
  return drawn;
}

size_t TreeVariables::bytes() const {
  return (theta_.capacity() + delta_.capacity()) * sizeof(double) +
         dof_.capacity() * (3 * sizeof(int32_t) + sizeof(Manifold) + 2 * sizeof(int64_t) + 2 + sizeof(uint32_t));
}

}  // namespace heliograph
