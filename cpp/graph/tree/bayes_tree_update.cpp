// SPDX-License-Identifier: MIT
// One update of the Bayes tree, step by step.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "graph/tree/bayes_tree.hpp"
#include "graph/ordering/ordering.hpp"
#include "graph/cholesky/plan_builder.hpp"

namespace heliograph {

void BayesTree::touch(int32_t variable) {
  uint8_t& flag = touched_flag_[static_cast<size_t>(variable)];
  if (flag != 0) return;
  flag = 1;
  touched_.push_back(variable);
}

void BayesTree::flag_up(int32_t clique) {
  while (clique >= 0 && cliques_[static_cast<size_t>(clique)].flagged != update_number_) {
    cliques_[static_cast<size_t>(clique)].flagged = update_number_;
    taken_.push_back(clique);
    clique = cliques_[static_cast<size_t>(clique)].parent;
  }
}

// Every clique that speaks of the variable: the one that eliminates it and those below that have it among their rows.
void BayesTree::flag_with(int32_t variable) {
  std::vector<int32_t> stack;
  const auto push_if_named = [&](int32_t c) {
    const std::vector<int32_t>& nodes = cliques_[static_cast<size_t>(c)].nodes;
    const auto rows = nodes.begin() + cliques_[static_cast<size_t>(c)].pivot_nodes;
    if (rows != nodes.begin() && std::find(rows, nodes.end(), variable) != nodes.end()) stack.push_back(c);  // no summary
  };
  if (clique_of_[static_cast<size_t>(variable)] >= 0) {
    stack.push_back(clique_of_[static_cast<size_t>(variable)]);
  } else if (open_) {
    for (const int32_t c : orphans_) push_if_named(c);
  }
  while (!stack.empty()) {
    const int32_t at = stack.back();
    stack.pop_back();
    flag_up(at);
    for (int32_t c = cliques_[static_cast<size_t>(at)].child; c >= 0; c = cliques_[static_cast<size_t>(c)].next) push_if_named(c);
  }
}

size_t BayesTree::relinearize(double threshold, size_t most, bool farthest_first) {
  std::vector<int32_t> kept;
  size_t count = 0;
  fluid_before_ = fluid_;
  looked_at_fluid_ = true;
  if (farthest_first && fluid_.size() > most)
    std::stable_sort(fluid_.begin(), fluid_.end(), [&](int32_t a, int32_t b) { return longest_element(a) > longest_element(b); });
  for (size_t i = 0; i < fluid_.size(); ++i) {
    const int32_t v = fluid_[i];
    if (count >= most) {
      kept.assign(fluid_.begin() + static_cast<std::ptrdiff_t>(i), fluid_.end());
      break;
    }
    const double length = longest_element(v);
    if (length <= threshold || length == 0.0) {
      fluid_flag_[static_cast<size_t>(v)] = 0;
      continue;
    }
    fluid_flag_[static_cast<size_t>(v)] = 0;
    ++count;
    const auto at = static_cast<size_t>(v);
    const FamilyBlock block{manifold_[at], dof_[at], storage_of(manifold_[at], dof_[at]), 1, 0,
                            static_cast<size_t>(theta_at_[at]), static_cast<size_t>(delta_at_[at])};
    double* theta = theta_.data() + block.value;
    double* delta = delta_.data() + block.tangent;
    saved_.push_back({v, {theta, theta + block.storage}, {delta, delta + block.dof}});
    retract_block(block, theta_.data(), delta_.data(), theta_.data());
    std::fill_n(delta, block.dof, 0.0);
    relinearized_.push_back(v);
    flag_with(v);
  }
  fluid_ = std::move(kept);
  return count;
}

void BayesTree::find_fluid(double threshold) {
  for (size_t v = 0; v < dof_.size(); ++v)
    if (fluid_flag_[v] == 0 && frozen_[v] == 0 && longest_element(static_cast<int32_t>(v)) > threshold) {
      fluid_flag_[v] = 1;
      fluid_.push_back(static_cast<int32_t>(v));
    }
}

void BayesTree::detach() {
  if (open_) carried_ = {affected_, orphans_, open_factors_};
  detached_ = true;
  for (const int32_t v : undo_) {
    flag_with(v);
    relinearized_.push_back(v);
  }
  for (const int32_t v : touched_) flag_up(clique_of_[static_cast<size_t>(v)]);
  const auto taken = [&](int32_t c) { return cliques_[static_cast<size_t>(c)].flagged == update_number_; };
  std::erase_if(orphans_, taken);  // left over from the last slice, like open factors
  std::erase_if(open_factors_, [&](int32_t f) { return factors_[static_cast<size_t>(f)].removed != 0; });
  std::sort(taken_.begin(), taken_.end());  // not the order of discovery: the result does not depend on it
  for (const int32_t v : relinearized_) touched_flag_[static_cast<size_t>(v)] |= 2;
  for (const int32_t c : taken_) {
    const Clique& clique = cliques_[static_cast<size_t>(c)];
    affected_.insert(affected_.end(), clique.nodes.begin(), clique.nodes.begin() + clique.pivot_nodes);
    for (int32_t f = clique.first_factor; f >= 0; f = factors_[static_cast<size_t>(f)].next)
      if (factors_[static_cast<size_t>(f)].removed == 0) open_factors_.push_back(f);
    for (int32_t child = clique.child; child >= 0; child = cliques_[static_cast<size_t>(child)].next)
      if (!taken(child)) orphans_.push_back(child);
  }
  for (const int32_t v : fresh_)
    if (held_[static_cast<size_t>(v)] == 0) affected_.push_back(v);
  std::sort(affected_.begin(), affected_.end());
  for (const int32_t f : loose_)
    if (factors_[static_cast<size_t>(f)].removed == 0) open_factors_.push_back(f);
  std::sort(open_factors_.begin(), open_factors_.end());
  number_affected();
  if (!relinearized_.empty())
    for (const int32_t f : open_factors_) {
      TreeFactor& factor = factors_[static_cast<size_t>(f)];
      const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
      const int32_t* scope = kind.variables.data() + static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity);
      for (int a = 0; a < kind.arity; ++a)
        if ((touched_flag_[static_cast<size_t>(scope[a])] & 2) != 0) factor.stale = 1;
    }
  counts_ = {0, taken_.size(), open_factors_.size(), 0, 0, 0.0};
}

void BayesTree::number_affected() {
  local_.resize(dof_.size(), -1);
  for (size_t i = 0; i < affected_.size(); ++i) local_[static_cast<size_t>(affected_[i])] = static_cast<int32_t>(i);
}

Elements BayesTree::elements() const {
  Elements out;
  for (const int32_t c : orphans_) {
    const Clique& clique = cliques_[static_cast<size_t>(c)];
    for (size_t i = static_cast<size_t>(clique.pivot_nodes); i < clique.nodes.size(); ++i)
      out.nodes.push_back(local_[static_cast<size_t>(clique.nodes[i])]);
    out.begin.push_back(static_cast<int32_t>(out.nodes.size()));
  }
  return out;
}

// Who is joined to whom by the open factors; and by the elements: each a node of its own that its members are joined to, or,
// where the order is known already, a chain of its members.
Adjacency BayesTree::adjacency(const Elements& elements, std::span<const int32_t> position) const {
  const bool chained = !position.empty();
  const size_t n = affected_.size() + (chained ? 0 : elements.size());
  std::vector<std::pair<int32_t, int32_t>> edges;
  for (const int32_t f : open_factors_) {
    const TreeFactor& factor = factors_[static_cast<size_t>(f)];
    const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
    const int32_t* scope = kind.variables.data() + static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity);
    for (int a = 0; a < kind.arity; ++a)
      for (int b = a + 1; b < kind.arity; ++b) {
        const int32_t i = local_[static_cast<size_t>(scope[a])], j = local_[static_cast<size_t>(scope[b])];
        if (i >= 0 && j >= 0) edges.emplace_back(i, j);
      }
  }
  std::vector<int32_t> members;
  for (size_t e = 0; e < elements.size(); ++e) {
    members.assign(elements.nodes.begin() + elements.begin[e], elements.nodes.begin() + elements.begin[e + 1]);
    if (chained) {
      std::sort(members.begin(), members.end(), [&](int32_t a, int32_t b) {
        return position[static_cast<size_t>(a)] < position[static_cast<size_t>(b)];
      });
      for (size_t i = 1; i < members.size(); ++i) edges.emplace_back(members[i - 1], members[i]);
    } else {
      for (const int32_t member : members) edges.emplace_back(static_cast<int32_t>(affected_.size() + e), member);
    }
  }
  Adjacency graph;
  graph.offset.assign(n + 1, 0);
  for (const auto& [a, b] : edges) {
    ++graph.offset[static_cast<size_t>(a) + 1];
    ++graph.offset[static_cast<size_t>(b) + 1];
  }
  std::partial_sum(graph.offset.begin(), graph.offset.end(), graph.offset.begin());
  graph.neighbour.resize(static_cast<size_t>(graph.offset.back()));
  std::vector<int64_t> fill(graph.offset.begin(), graph.offset.end() - 1);
  for (const auto& [a, b] : edges) {
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(a)]++)] = b;
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(b)]++)] = a;
  }
  tidy(graph);
  return graph;
}

// Between slices the order that the rest had is kept, where little has come: ordering all of it anew would be the larger part
// of the work. What new factors speak of goes last, as ever.
bool BayesTree::keep_order() {
  constexpr size_t kFew = 16;
  if (kept_order_.empty() || affected_.size() > kept_order_.size() + kFew) return false;
  std::vector<uint8_t> placed(affected_.size(), 0);
  order_.clear();
  for (const int32_t v : kept_order_) {
    const auto node = static_cast<size_t>(local_[static_cast<size_t>(v)]);
    placed[node] = 1;
    order_.push_back(static_cast<int32_t>(node));
  }
  for (size_t i = 0; i < affected_.size(); ++i)
    if (placed[i] == 0) order_.push_back(static_cast<int32_t>(i));
  std::stable_partition(order_.begin(), order_.end(), [&](int32_t node) {
    return (touched_flag_[static_cast<size_t>(affected_[static_cast<size_t>(node)])] & 1) == 0;
  });
  return true;
}

void BayesTree::reorder() {
  if (keep_order()) return;
  const Elements old = elements();
  const Adjacency graph = adjacency(old, {});
  std::vector<int32_t> weight(graph.size(), 1), group(graph.size(), 0);
  for (size_t i = 0; i < affected_.size(); ++i) {
    weight[i] = dof_[static_cast<size_t>(affected_[i])];
    // What is to be marginalised out is eliminated first. What the new factors speak of is eliminated last: it stays at the top, where the next factors will touch it.
    const uint8_t flag = touched_flag_[static_cast<size_t>(affected_[i])];
    group[i] = (flag & kLeaving) != 0 ? 1 : (flag & 1) != 0 ? 3 : 2;
  }
  order_.clear();
  for (const int32_t node : minimum_degree(graph, weight, group))
    if (static_cast<size_t>(node) < affected_.size()) order_.push_back(node);
}

// The stale ones among the open factors; with a plan, only those that its first fronts need, and the caller's own.
void BayesTree::linearize_stale(const Plan* plan, size_t done) {
  for (const int32_t f : open_factors_) {
    TreeFactor& factor = factors_[static_cast<size_t>(f)];
    if (factor.stale == 0) continue;
    const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
    if (plan != nullptr && kind.type != FactorType::custom && front_of(*plan, factor) >= done) continue;
    const auto index = static_cast<size_t>(factor.index);
    if (factor.clique >= 0) {
      old_.push_back({f, 0.0});
      old_blocks_.insert(old_blocks_.end(), factor.block, factor.block + block_size(kind));
    }
    linearize_group(kind, index, index + 1, theta_.data(), factor.block);
    factor.stale = 0;
    ++counts_.linearized;
  }
}

// The front in which a factor's first variable is eliminated; none where all are held.
size_t BayesTree::front_of(const Plan& plan, const TreeFactor& factor) const {
  const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
  const int32_t* scope = kind.variables.data() + static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity);
  int32_t first = std::numeric_limits<int32_t>::max();
  for (int a = 0; a < kind.arity; ++a) {
    const int32_t node = local_[static_cast<size_t>(scope[a])];
    if (node >= 0) first = std::min(first, plan.front_of[static_cast<size_t>(node)]);
  }
  return static_cast<size_t>(first);
}

Plan BayesTree::plan_elimination() const {
  const Elements old = elements();
  std::vector<int32_t> position(affected_.size()), weight(affected_.size());
  std::vector<uint8_t> apart(leaving_.empty() ? 0 : affected_.size());
  for (size_t i = 0; i < order_.size(); ++i) position[static_cast<size_t>(order_[i])] = static_cast<int32_t>(i);
  for (size_t i = 0; i < affected_.size(); ++i) weight[i] = dof_[static_cast<size_t>(affected_[i])];
  for (size_t i = 0; i < apart.size(); ++i) apart[i] = touched_flag_[static_cast<size_t>(affected_[i])] & kLeaving;
  std::vector<int32_t> scope(kMaxArity);
  const auto each = [&](auto&& visit) {
    for (const int32_t f : open_factors_) {
      const TreeFactor& factor = factors_[static_cast<size_t>(f)];
      const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
      const int32_t* variables = kind.variables.data() + static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity);
      for (int a = 0; a < kind.arity; ++a) scope[static_cast<size_t>(a)] = local_[static_cast<size_t>(variables[a])];
      visit(kind, factor.block, scope.data());
    }
  };
  return PlanBuilder(each, weight, find_supernodes(adjacency(old, position), weight, order_, old, apart), true).build(old);
}

int32_t BayesTree::eliminate(size_t most) {
  const Plan plan = plan_elimination();
  counts_.work = plan.flops;
  const size_t made = plan.fronts.size() - orphans_.size(), done = indivisible_ ? made : slice_of(plan, made, most);
  linearize_stale(&plan, done);
  std::vector<double*> factor(done, nullptr), update(plan.fronts.size(), nullptr);
  for (size_t e = 0; e < orphans_.size(); ++e) update[made + e] = cliques_[static_cast<size_t>(orphans_[e])].update;
  int32_t failed = done < made ? undetermined_fresh() : -1;
  if (failed < 0) failed = run(plan, done, factor, update);
  if (failed >= 0) {
    roll_back();
    return failed;
  }
  commit(plan, factor, update, done);
  return -1;
}

// Eliminates a plan's first fronts. Returns the variable at which one is not positive definite, its blocks given back, or -1.
int32_t BayesTree::run(const Plan& plan, size_t done, std::vector<double*>& factor, std::vector<double*>& update) {
  std::vector<double> diagonal(static_cast<size_t>(plan.scalars));
  const PlanView view = plan.view();
  const Assembly assembly{0.0, 0.0, diagonal.data()};
  for (size_t s = 0; s < done; ++s) {
    const FrontView& front = plan.fronts[s];
    factor[s] = clique_blocks_.take(static_cast<size_t>(front.height) * static_cast<size_t>(front.pivots));
    update[s] = clique_blocks_.take(static_cast<size_t>(front.update_height) * static_cast<size_t>(front.rows));
    int failed = kernels_.eliminate(view, static_cast<int32_t>(s), assembly, factor[s], update.data(), scratch_.data());
    if (failed < 0) failed = vanished(plan, s, factor, diagonal);
    if (failed < 0) continue;
    int32_t variable = -1, scalar = 0;
    for (int32_t i = front.node_begin; i < front.node_begin + front.node_pivots && scalar <= failed; ++i) {
      variable = affected_[static_cast<size_t>(plan.nodes[static_cast<size_t>(i)])];
      scalar += dof_[static_cast<size_t>(variable)];
    }
    give_back(plan, s + 1, factor, update);
    return variable;
  }
  return -1;
}

void BayesTree::give_back(const Plan& plan, size_t done, const std::vector<double*>& factor, const std::vector<double*>& update) {
  for (size_t s = 0; s < done; ++s) {
    const FrontView& f = plan.fronts[s];
    clique_blocks_.give_back(factor[s], static_cast<size_t>(f.height) * static_cast<size_t>(f.pivots));
    clique_blocks_.give_back(update[s], static_cast<size_t>(f.update_height) * static_cast<size_t>(f.rows));
  }
}

}  // namespace heliograph
