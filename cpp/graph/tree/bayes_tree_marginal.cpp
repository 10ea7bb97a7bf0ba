// SPDX-License-Identifier: MIT
// Variables that leave: they are eliminated first, which makes them leaves of the tree; then the leaves are cut off, and what
// they handed to their parents stays as a summary.
//
// A summary is linear about the linearisation points that its variables had then. Those points are kept from then on, so that
// every factor of these variables is linearised where the summary was (first estimates): were they moved, summary and factors
// would disagree about which directions the measurements leave free, and certainty would be gained that nothing measured.
#include <algorithm>
#include <stdexcept>
#include <utility>

#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

// Adds a summary to one that has all its variables. Both are lower triangles by columns, the gradient in one more row.
void add_summary(const Clique& from, const Clique& to, std::span<const int32_t> dof) {
  std::vector<int32_t> place;  // of each scalar
  for (const int32_t node : from.nodes) {
    int32_t at = 0;
    for (const int32_t other : to.nodes) {
      if (other == node) break;
      at += dof[static_cast<size_t>(other)];
    }
    for (int32_t k = 0; k < dof[static_cast<size_t>(node)]; ++k) place.push_back(at + k);
  }
  for (int32_t column = 0; column < from.rows; ++column) {
    const double* source = from.update + static_cast<int64_t>(column) * from.update_height;
    const int32_t c = place[static_cast<size_t>(column)];
    for (int32_t row = column; row < from.rows; ++row) {
      const int32_t r = place[static_cast<size_t>(row)];
      to.update[static_cast<int64_t>(std::min(r, c)) * to.update_height + std::max(r, c)] += source[row];
    }
    to.update[static_cast<int64_t>(c) * to.update_height + to.rows] += source[from.rows];
  }
}

bool has_all(const Clique& clique, const Clique& of) {
  return std::all_of(of.nodes.begin(), of.nodes.end(), [&](int32_t node) {
    return std::find(clique.nodes.begin(), clique.nodes.end(), node) != clique.nodes.end();
  });
}

}  // namespace

void BayesTree::leave(std::span<const int32_t> variables) {
  if (open_ || !idle()) throw std::invalid_argument("an update is under way");
  for (const int32_t v : variables)
    if (v < 0 || static_cast<size_t>(v) >= dof_.size() || clique_of_[static_cast<size_t>(v)] < 0)
      throw std::invalid_argument("a variable that is held or that there is not");
  for (const int32_t v : variables) {
    uint8_t& flag = touched_flag_[static_cast<size_t>(v)];
    if (flag != 0) continue;
    flag_with(v);
    touch(v);
    flag |= kLeaving;
    leaving_.push_back(v);
  }
}

std::vector<int32_t> BayesTree::drop_left() {
  for (const int32_t v : leaving_) touched_flag_[static_cast<size_t>(v)] = kLeaving;
  const auto leaves = [&](int32_t c) {
    const Clique& clique = cliques_[static_cast<size_t>(c)];
    return clique.pivot_nodes > 0 && touched_flag_[static_cast<size_t>(clique.nodes.front())] == kLeaving;
  };
  std::vector<int32_t> tops, dropped;
  for (const int32_t c : made_) {
    cliques_[static_cast<size_t>(c)].unsolved = 0;  // steps are as they were
    cliques_[static_cast<size_t>(c)].solved = solve_number_;
    const int32_t parent = cliques_[static_cast<size_t>(c)].parent;
    if (leaves(c) && (parent < 0 || !leaves(parent))) tops.push_back(c);
  }
  for (const int32_t c : tops) {
    forget_below(c, dropped);
    summarize(c);
  }
  for (size_t i = leaving_.size(); i-- > 0;) {
    touched_flag_[static_cast<size_t>(leaving_[i])] = 0;
    free_variable(leaving_[i]);
  }
  for (std::vector<int32_t>* list : {&leaving_, &made_, &attached_}) list->clear();
  return dropped;
}

// Drops the factors of a clique and all that hangs below it; there is nothing below that does not leave with it.
void BayesTree::forget_below(int32_t index, std::vector<int32_t>& dropped) {
  std::vector<int32_t> stack{index};
  while (!stack.empty()) {
    const int32_t at = stack.back();
    stack.pop_back();
    for (int32_t c = cliques_[static_cast<size_t>(at)].child; c >= 0; c = cliques_[static_cast<size_t>(c)].next) stack.push_back(c);
    for (int32_t f = cliques_[static_cast<size_t>(at)].first_factor; f >= 0;) {
      const int32_t next = factors_[static_cast<size_t>(f)].next;
      drop_factor(f);
      dropped.push_back(std::exchange(f, next));
    }
    if (at != index) release(at);
  }
  cliques_[static_cast<size_t>(index)].child = -1;
  cliques_[static_cast<size_t>(index)].first_factor = -1;
}

// A clique loses its pivots.
void BayesTree::summarize(int32_t index) {
  Clique& clique = cliques_[static_cast<size_t>(index)];
  clique_blocks_.give_back(clique.factor, static_cast<size_t>(clique.height) * static_cast<size_t>(clique.pivots));
  clique.factor = nullptr;
  clique.nodes.erase(clique.nodes.begin(), clique.nodes.begin() + clique.pivot_nodes);
  clique.pivot_nodes = clique.pivots = clique.height = 0;
  for (const int32_t v : clique.nodes) freeze(v);
  if (clique.nodes.empty()) {  // it was all of its part of the graph
    unlink(index);
    release(index);
    return;
  }
  merge_summary(index);
}

void BayesTree::freeze(int32_t variable) {
  const auto v = static_cast<size_t>(variable);
  frozen_[v] = 1;
  if (std::exchange(fluid_flag_[v], 0) != 0) std::erase(fluid_, variable);
}

// Summaries of the same variables become one, so that their number does not grow with what has left.
void BayesTree::merge_summary(int32_t index) {
  const int32_t parent = cliques_[static_cast<size_t>(index)].parent;
  std::vector<int32_t> others;
  for (int32_t c = cliques_[static_cast<size_t>(parent)].child; c >= 0; c = cliques_[static_cast<size_t>(c)].next)
    if (c != index && cliques_[static_cast<size_t>(c)].pivot_nodes == 0) others.push_back(c);
  int32_t into = index;
  for (const int32_t c : others) {
    const Clique &a = cliques_[static_cast<size_t>(into)], &b = cliques_[static_cast<size_t>(c)];
    const bool keep = has_all(a, b);
    if (!keep && !has_all(b, a)) continue;
    add_summary(keep ? b : a, keep ? a : b, dof_);
    const int32_t gone = keep ? c : std::exchange(into, c);
    unlink(gone);
    release(gone);
  }
}

}  // namespace heliograph
