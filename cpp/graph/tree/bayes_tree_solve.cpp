// SPDX-License-Identifier: MIT
// Steps, from the root of the Bayes tree down: only as far as they change (wildfire), and only so many at once.
//
// A clique has to be solved where one of its rows has changed since it was solved last. What an update leaves undone is known
// by its topmost cliques, which wait in a queue; below them steps are old, consistently so, until their turn comes.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

// Memory of a clique that is solved soon; solving takes about as long as fetching.
void prefetch(const Clique& clique) {
  constexpr int64_t kLine = 8, kMost = 64;  // doubles a cache line, lines
  __builtin_prefetch(clique.nodes.data());
  const int64_t lines = std::min<int64_t>(int64_t{clique.height} * clique.pivots / kLine + 1, kMost);
  for (int64_t i = 0; i < lines; ++i) __builtin_prefetch(clique.factor + kLine * i);
}

}  // namespace

bool BayesTree::rows_changed(const Clique& clique) const {
  for (size_t i = static_cast<size_t>(clique.pivot_nodes); i < clique.nodes.size(); ++i)
    if (changed_[static_cast<size_t>(clique.nodes[i])] > clique.solved) return true;
  return false;
}

// Into step_, from the steps of the rows as `step_of(variable)` points to them.
template <typename StepOf>
void BayesTree::compute_step(const Clique& clique, StepOf&& step_of, std::vector<double>& rows, std::vector<double>& step) const {
  rows.resize(static_cast<size_t>(clique.rows) + 8);
  step.resize(static_cast<size_t>(clique.pivots));
  double* to = rows.data();
  for (size_t i = static_cast<size_t>(clique.pivot_nodes); i < clique.nodes.size(); ++i)
    to = std::copy_n(step_of(clique.nodes[i]), dof_[static_cast<size_t>(clique.nodes[i])], to);
  FrontView front;
  front.pivots = clique.pivots;
  front.rows = clique.rows;
  front.height = clique.height;
  kernels_.back_substitute(front, clique.factor, nullptr, rows.data(), step.data());
}

// The step of a clique's pivots. Unless it is new, its old step stays where no element moves by more than the threshold, so
// that what lies below it stays consistent and need not be visited.
void BayesTree::solve_clique(int32_t index) {
  Clique& clique = cliques_[static_cast<size_t>(index)];
  const bool always = std::exchange(clique.unsolved, 0) != 0;
  clique.deferred = 0;
  clique.solved = solve_number_;
  compute_step(clique, [&](int32_t v) { return delta_.data() + delta_at_[static_cast<size_t>(v)]; }, rows_, step_);
  counts_.solved += static_cast<size_t>(clique.pivot_nodes);
  const double* from = step_.data();
  double moved = 0.0;
  for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
    const auto v = static_cast<size_t>(clique.nodes[static_cast<size_t>(i)]);
    for (int k = 0; k < dof_[v]; ++k) moved = std::max(moved, std::abs(delta_[static_cast<size_t>(delta_at_[v] + k)] - *from++));
  }
  if (!(moved > wildfire_) && !always) return;
  from = step_.data();
  for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
    const int32_t variable = clique.nodes[static_cast<size_t>(i)];
    const auto v = static_cast<size_t>(variable);
    changed_[v] = solve_number_;
    double longest = 0.0;
    for (int k = 0; k < dof_[v]; ++k) {
      longest = std::max(longest, std::abs(*from));
      delta_[static_cast<size_t>(delta_at_[v] + k)] = *from++;
    }
    if (longest > fluid_threshold_ && frozen_[v] == 0 && std::exchange(fluid_flag_[v], 1) == 0) fluid_.push_back(variable);
  }
}

// Carries steps down from the cliques on the stack; those that are left when `most` variables are done are put off.
void BayesTree::carry_down(std::vector<int32_t>& stack, size_t most) {
  while (!stack.empty() && counts_.solved < most) {
    const int32_t at = stack.back();
    stack.pop_back();
    if (!stack.empty()) prefetch(cliques_[static_cast<size_t>(stack.back())]);  // comes while this one is computed
    const Clique& clique = cliques_[static_cast<size_t>(at)];
    if (clique.pivot_nodes == 0 || (clique.unsolved == 0 && !rows_changed(clique))) continue;
    solve_clique(at);
    for (int32_t c = clique.child; c >= 0; c = cliques_[static_cast<size_t>(c)].next) {
      __builtin_prefetch(&cliques_[static_cast<size_t>(c)]);
      stack.push_back(c);
    }
  }
  for (const int32_t c : stack) {
    Clique& clique = cliques_[static_cast<size_t>(c)];
    if (clique.pivot_nodes == 0 || clique.deferred != 0 || (clique.unsolved == 0 && !rows_changed(clique))) continue;
    clique.deferred = 1;
    deferred_.push_back(c);
  }
  stack.clear();
}

// The oldest first. Each is a solve of its own: where one lies above another that was done before it, that one comes again.
void BayesTree::catch_up(size_t most) {
  std::vector<int32_t> stack;
  size_t done = 0;
  while (done < deferred_.size() && counts_.solved < most) {
    const int32_t at = deferred_[done++];
    if (std::exchange(cliques_[static_cast<size_t>(at)].deferred, 0) == 0) continue;  // done meanwhile, or made anew
    ++solve_number_;
    stack.push_back(at);
    carry_down(stack, most);
  }
  deferred_.erase(deferred_.begin(), deferred_.begin() + static_cast<std::ptrdiff_t>(done));
  if (deferred_.size() > cliques())  // cliques that were made anew meanwhile
    std::erase_if(deferred_, [&](int32_t c) { return cliques_[static_cast<size_t>(c)].deferred == 0; });
}

size_t BayesTree::solve(double wildfire, double relinearize_threshold, size_t most, size_t later) {
  ++solve_number_;
  wildfire_ = wildfire;
  fluid_threshold_ = relinearize_threshold;
  // Steps are cheap beside elimination: where that took down a good part of the tree, nothing is left stale.
  constexpr size_t kGoodPart = 10;
  if (std::exchange(eliminated_, 0) * kGoodPart >= variables()) wildfire_ = 0.0;
  for (size_t s = made_.size(); s-- > 0;) solve_clique(made_[s]);
  std::vector<int32_t> stack(attached_);
  for (const int32_t c : roots_)  // parts of the graph that an earlier slice was done with
    if (cliques_[static_cast<size_t>(c)].unsolved != 0) stack.push_back(c);
  carry_down(stack, most);
  const size_t own = counts_.solved;
  catch_up(own + std::min(later, most > own ? most - own : 0));
  wildfire_ = wildfire;
  return counts_.solved - own;
}

void BayesTree::finish_steps() {
  if (!deferred_.empty()) catch_up(std::numeric_limits<size_t>::max());
}

// A variable's step. Below a clique that was put off it is computed from there down, on the way to the variable alone.
std::vector<double> BayesTree::step_of(int32_t variable) const {
  const auto v = static_cast<size_t>(variable);
  const double* delta = delta_.data() + delta_at_.at(v);
  std::vector<int32_t> path;
  size_t old = 0;
  for (int32_t c = deferred_.empty() ? -1 : clique_of_[v]; c >= 0; c = cliques_[static_cast<size_t>(c)].parent) {
    path.push_back(c);
    if (cliques_[static_cast<size_t>(c)].deferred != 0) old = path.size();
  }
  if (old == 0) return {delta, delta + dof_[v]};
  std::map<int32_t, std::vector<double>> found;
  std::vector<double> rows, step;
  while (old-- > 0) {
    const Clique& clique = cliques_[static_cast<size_t>(path[old])];
    const auto known = [&](int32_t node) {
      const auto at = found.find(node);
      return at == found.end() ? delta_.data() + delta_at_[static_cast<size_t>(node)] : at->second.data();
    };
    compute_step(clique, known, rows, step);
    const double* from = step.data();
    for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
      const int32_t node = clique.nodes[static_cast<size_t>(i)];
      found[node].assign(from, from + dof_[static_cast<size_t>(node)]);
      from += dof_[static_cast<size_t>(node)];
    }
  }
  return found.at(variable);
}

std::vector<double> BayesTree::estimate(std::span<const int32_t> variables) {
  constexpr size_t kFew = 16;  // beyond, all that was put off is done at once
  if (variables.size() > kFew) finish_steps();
  std::vector<double> out;
  for (const int32_t variable : variables) {
    const auto v = static_cast<size_t>(variable);
    const int storage = storage_of(manifold_.at(v), dof_[v]);
    const size_t at = out.size();
    out.resize(at + static_cast<size_t>(storage));
    const FamilyBlock block{manifold_[v], dof_[v], storage, 1, 0, 0, 0};
    if (deferred_.empty()) {
      retract_block(block, theta_.data() + theta_at_[v], delta_.data() + delta_at_[v], out.data() + at);
    } else {
      retract_block(block, theta_.data() + theta_at_[v], step_of(variable).data(), out.data() + at);
    }
  }
  return out;
}

}  // namespace heliograph
