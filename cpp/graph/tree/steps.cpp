// SPDX-License-Identifier: MIT
#include "graph/tree/steps.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

namespace heliograph {

namespace {

// Memory of a clique that is solved soon; solving takes about as long as fetching.
void prefetch(const Clique& clique) {
  constexpr int64_t kLineDoubles = 8, kMaxLines = 64;
  __builtin_prefetch(clique.nodes.data());
  const int64_t lines = std::min<int64_t>(int64_t{clique.height} * clique.pivots / kLineDoubles + 1, kMaxLines);
  for (int64_t i = 0; i < lines; ++i) __builtin_prefetch(clique.factor + kLineDoubles * i);
}

}  // namespace

void TreeSteps::expect(std::vector<int32_t> made, std::vector<int32_t> attached, size_t variables) {
  made_ = std::move(made);
  attached_ = std::move(attached);
  eliminated_ += variables;
}

std::vector<int32_t> TreeSteps::keep() {
  for (const int32_t c : made_) {
    store_.cliques[c].unsolved = 0;
    store_.cliques[c].solved = solve_number_;
  }
  attached_.clear();
  return std::exchange(made_, {});
}

bool TreeSteps::rows_changed(const Clique& clique) const {
  for (int32_t i = clique.first_row(); i < clique.node_count(); ++i)
    if (store_.variables.changed(clique.node(i)) > clique.solved) return true;
  return false;
}

// The step of a clique's pivots, from those of its rows as `step_of(variable)` points to them.
template <typename StepOf>
void TreeSteps::compute(const Clique& clique, StepOf&& step_of, std::vector<double>& rows, std::vector<double>& step) const {
  constexpr size_t kPadding = 8;  // doubles that a kernel may read past the rows
  rows.resize(static_cast<size_t>(clique.rows) + kPadding);
  step.resize(static_cast<size_t>(clique.pivots));
  double* to = rows.data();
  for (int32_t i = clique.first_row(); i < clique.node_count(); ++i)
    to = std::copy_n(step_of(clique.node(i)), store_.variables.dof(clique.node(i)), to);
  FrontView front;
  front.pivots = clique.pivots;
  front.rows = clique.rows;
  front.height = clique.height;
  kernels_.back_substitute(front, clique.factor, nullptr, rows.data(), step.data());
}

// Unless it is new, a clique's old step stays where no element moves by more than the threshold, so that what lies below it
// stays consistent and need not be visited.
void TreeSteps::solve_clique(int32_t index) {
  Clique& clique = store_.cliques[index];
  TreeVariables& variables = store_.variables;
  const bool always = std::exchange(clique.unsolved, uint8_t{0}) != 0;
  clique.deferred = 0;
  clique.solved = solve_number_;
  compute(clique, [&](int32_t v) { return variables.delta(v); }, rows_, step_);
  solved_ += static_cast<size_t>(clique.pivot_nodes);
  const double* from = step_.data();
  double moved = 0.0;
  for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
    const double* old = variables.delta(clique.node(i));
    for (int k = 0; k < variables.dof(clique.node(i)); ++k) moved = std::max(moved, std::abs(old[k] - *from++));
  }
  if (!(moved > wildfire_) && !always) return;
  from = step_.data();
  for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
    const int32_t v = clique.node(i);
    variables.set_step(v, from, solve_number_);
    if (variables.longest_element(v) > relinearize_) variables.add_fluid(v);
    from += variables.dof(v);
  }
}

// Carries steps down from the cliques on the stack; those that are left when `max` variables are done are deferred.
void TreeSteps::carry_down(std::vector<int32_t>& stack, size_t max) {
  TreeCliques& cliques = store_.cliques;
  while (!stack.empty() && solved_ < max) {
    const int32_t at = stack.back();
    stack.pop_back();
    if (!stack.empty()) prefetch(cliques[stack.back()]);  // comes while this one is computed
    if (!due(cliques[at])) continue;
    if (const int32_t child = cliques[at].child; child >= 0) prefetch(cliques[child]);
    solve_clique(at);
    cliques.each_child(at, [&](int32_t child) {
      __builtin_prefetch(&cliques[child]);
      stack.push_back(child);
    });
  }
  for (const int32_t c : stack) {
    if (cliques[c].deferred != 0 || !due(cliques[c])) continue;
    cliques[c].deferred = 1;
    deferred_.push_back(c);
  }
  stack.clear();
}

// The oldest first. Each is a solve of its own: where one lies above another that was done before it, that one comes again.
void TreeSteps::catch_up(size_t max) {
  std::vector<int32_t> stack;
  size_t done = 0;
  while (done < deferred_.size() && solved_ < max) {
    const int32_t at = deferred_[done++];
    if (std::exchange(store_.cliques[at].deferred, uint8_t{0}) == 0) continue;  // done meanwhile, or made again
    ++solve_number_;
    stack.push_back(at);
    carry_down(stack, max);
  }
  deferred_.erase(deferred_.begin(), deferred_.begin() + static_cast<std::ptrdiff_t>(done));
  if (deferred_.size() > store_.cliques.count())  // cliques that were made again meanwhile
    std::erase_if(deferred_, [&](int32_t c) { return store_.cliques[c].deferred == 0; });
}

StepCounts TreeSteps::solve(const StepLimits& limits) {
  ++solve_number_;
  solved_ = 0;
  wildfire_ = limits.wildfire;
  relinearize_ = limits.relinearize;
  // Steps are cheap beside elimination: where that took down a good part of the tree, nothing is left stale.
  constexpr size_t kGoodPart = 10;  // one part in this many, of all variables
  if (std::exchange(eliminated_, size_t{0}) * kGoodPart >= store_.variables.count()) wildfire_ = 0.0;
  for (size_t s = made_.size(); s-- > 0;) solve_clique(made_[s]);
  std::vector<int32_t> stack(attached_);
  for (const int32_t c : store_.cliques.roots())  // parts of the graph that an earlier slice was done with
    if (store_.cliques[c].unsolved != 0) stack.push_back(c);
  carry_down(stack, limits.max);
  const size_t own = solved_;
  catch_up(own + std::min(limits.max_deferred, limits.max > own ? limits.max - own : 0));
  wildfire_ = limits.wildfire;
  return {solved_, solved_ - own};
}

size_t TreeSteps::finish() {
  solved_ = 0;
  if (!deferred_.empty()) catch_up(std::numeric_limits<size_t>::max());
  return solved_;
}

// A variable's step. Below a deferred clique it is computed from there down, on the way to the variable alone.
std::vector<double> TreeSteps::step_of(int32_t variable) const {
  const TreeVariables& variables = store_.variables;
  const double* delta = variables.delta(variable);
  std::vector<int32_t> path;
  size_t old = 0;
  for (int32_t c = deferred_.empty() ? -1 : variables.clique_of(variable); c >= 0; c = store_.cliques[c].parent) {
    path.push_back(c);
    if (store_.cliques[c].deferred != 0) old = path.size();
  }
  if (old == 0) return {delta, delta + variables.dof(variable)};
  std::map<int32_t, std::vector<double>> found;
  std::vector<double> rows, step;
  while (old-- > 0) {
    const Clique& clique = store_.cliques[path[old]];
    const auto known = [&](int32_t node) {
      const auto at = found.find(node);
      return at == found.end() ? variables.delta(node) : at->second.data();
    };
    compute(clique, known, rows, step);
    const double* from = step.data();
    for (int32_t i = 0; i < clique.pivot_nodes; ++i) {
      found[clique.node(i)].assign(from, from + variables.dof(clique.node(i)));
      from += variables.dof(clique.node(i));
    }
  }
  return found.at(variable);
}

std::vector<double> TreeSteps::estimate(std::span<const int32_t> variables) {
  constexpr size_t kFewVariables = 16;  // beyond, all that is deferred is done at once
  if (variables.size() > kFewVariables) finish();
  std::vector<double> out;
  for (const int32_t v : variables) {
    const size_t at = out.size();
    out.resize(at + static_cast<size_t>(store_.variables.storage(v)));
    store_.variables.retract(v, deferred_.empty() ? store_.variables.delta(v) : step_of(v).data(), out.data() + at);
  }
  return out;
}

}  // namespace heliograph
