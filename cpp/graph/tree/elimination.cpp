// SPDX-License-Identifier: MIT
#include "graph/tree/elimination.hpp"

#include <algorithm>
#include <utility>

#include "graph/cholesky/plan_builder.hpp"
#include "graph/ordering/fill.hpp"
#include "graph/ordering/ordering.hpp"
#include "graph/tree/kernels.hpp"
#include "graph/tree/rank.hpp"

namespace heliograph {

namespace {

constexpr size_t kMaxLast = 16;   // variables that are held last whatever it costs
constexpr double kMaxCost = 1.5;  // of an order that holds more of them last, beside one that does not

}  // namespace

TreeElimination::TreeElimination(TreeStore& store, TreeJournal& journal, TreeTop& top)
    : store_(store), journal_(journal), top_(top), kernels_(front_kernels()), scratch_(static_cast<size_t>(kScratch)) {}

// Between slices the order that the rest had is kept, where little has come: ordering all of it again would be the larger part
// of the work. What new factors speak of goes last, as ever.
bool TreeElimination::continue_order() {
  constexpr size_t kMaxNew = 16;  // variables
  const std::vector<int32_t>& affected = top_.affected();
  if (kept_order_.empty() || affected.size() > kept_order_.size() + kMaxNew) return false;
  const auto touched = [&](int32_t v) { return (journal_.marks(v) & TreeJournal::kTouched) != 0; };
  if (static_cast<size_t>(std::count_if(affected.begin(), affected.end(), touched)) > kMaxLast) return false;
  std::vector<uint8_t> placed(affected.size(), 0);
  order_.clear();
  for (const int32_t v : kept_order_) {
    placed[static_cast<size_t>(top_.node_of(v))] = 1;
    order_.push_back(top_.node_of(v));
  }
  for (size_t i = 0; i < affected.size(); ++i)
    if (placed[i] == 0) order_.push_back(static_cast<int32_t>(i));
  std::stable_partition(order_.begin(), order_.end(), [&](int32_t node) { return !touched(top_.affected(node)); });
  return true;
}

// The affected in the order of minimum degree under the constraint.
std::vector<int32_t> TreeElimination::ordered(const Adjacency& graph, std::span<const int32_t> weight,
                                              std::span<const int32_t> group) const {
  const size_t variables = top_.affected().size();
  std::vector<int32_t> order;
  order.reserve(variables);
  for (const int32_t node : minimum_degree(graph, weight, group))
    if (static_cast<size_t>(node) < variables) order.push_back(node);
  return order;
}

// What an order costs, the orphans' elements counted in.
double TreeElimination::flops_of(const Elements& elements, std::span<const int32_t> order) const {
  std::vector<int32_t> position(order.size()), weight(order.size());
  for (size_t i = 0; i < order.size(); ++i) {
    position[static_cast<size_t>(order[i])] = static_cast<int32_t>(i);
    weight[i] = store_.variables.dof(top_.affected(static_cast<int32_t>(i)));
  }
  return fill_of_order(top_.chained_graph(elements, position), weight, order).flops;
}

void TreeElimination::reorder() {
  if (continue_order()) return;
  const Elements elements = top_.elements();
  const Adjacency graph = top_.quotient_graph(elements);
  const size_t variables = top_.affected().size();
  std::vector<int32_t> weight(graph.size(), 1), group(graph.size(), 0);
  size_t touched = 0;
  for (size_t i = 0; i < variables; ++i) {
    const int32_t v = top_.affected()[i];
    weight[i] = store_.variables.dof(v);
    // What new factors speak of stays at the top, where the next ones will touch it.
    const uint8_t marks = journal_.marks(v);
    group[i] = (marks & TreeJournal::kLeaving) != 0 ? 1 : (marks & TreeJournal::kTouched) != 0 ? 3 : 2;
    touched += group[i] == 3 ? 1 : 0;
  }
  order_ = ordered(graph, weight, group);
  // Factors on every pose (all fixes of a drive) say nothing of where the next ones come, and all poses held last are
  // joined to each other by the velocities and biases that go before them: such an order fills the factor.
  if (touched <= kMaxLast || touched == variables) return;
  std::replace(group.begin(), group.end(), 3, 2);
  std::vector<int32_t> free = ordered(graph, weight, group);
  if (flops_of(elements, order_) > kMaxCost * flops_of(elements, free)) order_ = std::move(free);
}

Plan TreeElimination::plan() const {
  const std::vector<int32_t>& affected = top_.affected();
  const Elements elements = top_.elements();
  std::vector<int32_t> position(affected.size()), weight(affected.size());
  std::vector<uint8_t> apart(affected.size());
  for (size_t i = 0; i < order_.size(); ++i) position[static_cast<size_t>(order_[i])] = static_cast<int32_t>(i);
  for (size_t i = 0; i < affected.size(); ++i) {
    weight[i] = store_.variables.dof(affected[i]);
    apart[i] = journal_.marks(affected[i]) & TreeJournal::kLeaving;
  }
  std::vector<int32_t> nodes(kMaxArity);
  const auto each = [&](auto&& visit) {
    for (const int32_t f : top_.factors()) {
      const TreeFactor& factor = store_.factors[f];
      const auto scope = store_.factors.scope(factor);
      std::transform(scope.begin(), scope.end(), nodes.begin(), [&](int32_t v) { return top_.node_of(v); });
      visit(store_.factors.kind_of(factor), factor.block, nodes.data());
    }
  };
  const Adjacency graph = top_.chained_graph(elements, position);
  return PlanBuilder(each, weight, find_supernodes(graph, weight, order_, elements, apart), true).build(elements);
}

size_t TreeElimination::linearize(int32_t number) {
  journal_.linearize(number);
  return 1;
}

size_t TreeElimination::linearize_all() {
  size_t count = 0;
  for (const int32_t f : top_.factors())
    if (store_.factors[f].stale != 0) count += linearize(f);
  return count;
}

// Only those that the plan's first fronts need, and the caller's own.
size_t TreeElimination::linearize_for(const Plan& plan, size_t done) {
  size_t count = 0;
  for (const int32_t f : top_.factors()) {
    const TreeFactor& factor = store_.factors[f];
    if (factor.stale == 0) continue;
    const bool custom = store_.factors.kind_of(factor).type == FactorType::custom;
    if (custom || top_.front_of(plan, factor) < done) count += linearize(f);
  }
  return count;
}

namespace {

// How many of a plan's fronts are eliminated now: those that fit, and at least one.
size_t fronts_within(const Plan& plan, size_t fronts, size_t max) {
  size_t done = 0, variables = 0;
  while (done < fronts) {
    variables += static_cast<size_t>(plan.fronts[done].node_pivots);
    if (done > 0 && variables > max) break;
    ++done;
  }
  return done;
}

}  // namespace

EliminatedFronts TreeElimination::run(size_t max) {
  EliminatedFronts out;
  out.plan = plan();
  out.fronts = out.plan.fronts.size() - top_.orphans().size();
  const bool whole = journal_.indivisible() || max >= top_.affected().size();
  out.done = whole ? out.fronts : fronts_within(out.plan, out.fronts, max);
  out.linearized = linearize_for(out.plan, out.done);
  if (out.done < out.fronts) out.undetermined = undetermined_fresh(out.linearized);
  if (out.undetermined < 0) out.undetermined = eliminate(out);
  return out;
}

// Returns the variable at which a front is not positive definite, all blocks given back, or -1.
int32_t TreeElimination::eliminate(EliminatedFronts& out) {
  const Plan& plan = out.plan;
  out.factor.assign(out.done, nullptr);
  out.update.assign(plan.fronts.size(), nullptr);
  for (size_t e = 0; e < top_.orphans().size(); ++e) out.update[out.fronts + e] = store_.cliques[top_.orphan(e)].update;
  std::vector<double> diagonal(static_cast<size_t>(plan.scalars));
  const PlanView view = plan.view();
  const Assembly assembly{0.0, 0.0, diagonal.data()};
  const FrontBlocks blocks{plan, out.factor, top_.orphans(), store_.cliques};
  for (size_t s = 0; s < out.done; ++s) {
    const FrontView& front = plan.fronts[s];
    out.factor[s] = store_.cliques.take_block(static_cast<size_t>(front.height) * static_cast<size_t>(front.pivots));
    out.update[s] = store_.cliques.take_block(static_cast<size_t>(front.update_height) * static_cast<size_t>(front.rows));
    int failed = kernels_.eliminate(view, static_cast<int32_t>(s), assembly, out.factor[s], out.update.data(), scratch_.data());
    if (failed < 0) failed = vanished_pivot(blocks, s, diagonal);
    if (failed < 0) continue;
    int32_t variable = -1, scalar = 0;
    for (int32_t i = front.node_begin; i < front.node_begin + front.node_pivots && scalar <= failed; ++i) {
      variable = top_.affected(plan.nodes[static_cast<size_t>(i)]);
      scalar += store_.variables.dof(variable);
    }
    give_back(out, s + 1);
    return variable;
  }
  return -1;
}

void TreeElimination::give_back(const EliminatedFronts& eliminated, size_t done) {
  for (size_t s = 0; s < done; ++s) {
    const FrontView& front = eliminated.plan.fronts[s];
    store_.cliques.give_back_block(eliminated.factor[s], static_cast<size_t>(front.height) * static_cast<size_t>(front.pivots));
    store_.cliques.give_back_block(eliminated.update[s],
                                   static_cast<size_t>(front.update_height) * static_cast<size_t>(front.rows));
  }
}

// A variable that the new factors leave free even where all older ones are known, or -1. Because the information of the
// older ones is positive definite, that of all is exactly where this part of it is: asked before work is begun that, being
// spread over several updates, could not be taken back later.
int32_t TreeElimination::undetermined_fresh(size_t& linearized) {
  TreeTop::Part part;
  for (const int32_t v : journal_.fresh())
    if (!store_.variables.held(v)) part.affected.push_back(v);
  if (part.affected.empty()) return -1;
  std::sort(part.affected.begin(), part.affected.end());
  std::copy_if(journal_.loose().begin(), journal_.loose().end(), std::back_inserter(part.factors),
               [&](int32_t f) { return store_.factors[f].speaks(); });
  std::vector<int32_t> kept = std::exchange(kept_order_, {});
  TreeTop::Part whole = top_.exchange(std::move(part));
  linearized += linearize_all();
  reorder();
  EliminatedFronts trial;
  trial.plan = plan();
  trial.fronts = trial.done = trial.plan.fronts.size();
  const int32_t failed = eliminate(trial);
  if (failed < 0) give_back(trial, trial.done);
  top_.exchange(std::move(whole));
  kept_order_ = std::move(kept);
  return failed;
}

void TreeElimination::keep_rest(const EliminatedFronts& eliminated) {
  kept_order_.clear();
  for (size_t s = eliminated.done; s < eliminated.fronts; ++s) {
    const FrontView& front = eliminated.plan.fronts[s];
    for (int32_t i = front.node_begin; i < front.node_begin + front.node_pivots; ++i)
      kept_order_.push_back(top_.affected(eliminated.plan.nodes[static_cast<size_t>(i)]));
  }
}

}  // namespace heliograph
