// SPDX-License-Identifier: MIT
#include "graph/tree/bayes_tree.hpp"

#include <algorithm>
#include <chrono>
#include <stdexcept>
#include <utility>

#include "graph/tree/innovation.hpp"
#include "graph/tree/regrow.hpp"

namespace heliograph {

size_t BayesTree::relinearize(double threshold, size_t max, bool farthest_first) {
  const std::vector<int32_t> moved = journal_.relinearize(threshold, max, farthest_first);
  for (const int32_t v : moved) top_.mark_with(v);
  return moved.size();
}

void BayesTree::detach() {
  top_.detach(journal_);
  counts_ = {0, top_.taken().size(), top_.factors().size(), 0, 0, 0.0};
}

std::vector<int32_t> BayesTree::stale_factors(int32_t kind) const {
  std::vector<int32_t> out;
  for (const int32_t f : top_.factors())
    if (store_.factors[f].kind == kind && store_.factors[f].stale != 0) out.push_back(f);
  return out;
}

int32_t BayesTree::eliminate(size_t max) {
  const EliminatedFronts eliminated = elimination_.run(max);
  counts_.work = eliminated.plan.flops;
  counts_.linearized = eliminated.linearized;
  if (eliminated.undetermined >= 0) {
    undo();
    return eliminated.undetermined;
  }
  Regrown grown = regrow(store_, top_, eliminated);
  counts_.variables = top_.affected().size() - grown.rest.affected.size();
  elimination_.keep_rest(eliminated);
  journal_.commit(!grown.rest.affected.empty());
  top_.close(std::move(grown.rest));
  steps_.expect(std::move(grown.made), std::move(grown.attached), counts_.variables);
  return -1;
}

PassReport BayesTree::advance(const PassLimits& limits) {
  using Clock = std::chrono::steady_clock;
  PassReport report;
  auto last = Clock::now();
  size_t step = 0;
  const auto lap = [&] {
    const auto now = Clock::now();
    report.seconds[step++] = std::chrono::duration<double>(now - std::exchange(last, now)).count();
  };
  if (limits.relinearize > 0) report.relinearized = relinearize(limits.threshold, limits.relinearize, limits.farthest_first);
  lap();
  detach();
  lap();
  reorder();
  lap();
  report.undetermined = eliminate(limits.eliminate);
  lap();
  if (report.undetermined < 0 && waiting() == 0) report.caught_up = solve(limits.steps);
  lap();
  return report;
}

void BayesTree::undo() {
  journal_.roll_back(top_.factors(), top_.open() && top_.detached());
  top_.roll_back();
  marginal_.give_up();
}

size_t BayesTree::solve(const StepLimits& limits) {
  const StepCounts done = steps_.solve(limits);
  counts_.solved += done.solved;
  return done.caught_up;
}

void BayesTree::leave(std::span<const int32_t> variables) {
  if (top_.open() || !idle()) throw std::invalid_argument("an update is under way");
  marginal_.leave(variables, journal_, top_);
}

void BayesTree::check_slots(std::span<const int32_t> variables) const {
  for (const int32_t v : variables)
    if (!store_.variables.has_slot(v)) throw std::out_of_range("a variable that there is not");
}

bool BayesTree::held(int32_t variable) const {
  check_slots({&variable, 1});
  return store_.variables.held(variable);
}

// Factors are assembled where the first of their variables is eliminated: in its clique, or below in one that has it as a row.
std::vector<int32_t> BayesTree::factors_of(int32_t variable) const {
  check_slots({&variable, 1});
  std::vector<int32_t> found, stack;
  if (const int32_t clique = store_.variables.clique_of(variable); clique >= 0) stack.push_back(clique);
  while (!stack.empty()) {
    const int32_t c = stack.back();
    stack.pop_back();
    const Clique& clique = store_.cliques[c];
    if (std::find(clique.nodes.begin(), clique.nodes.end(), variable) == clique.nodes.end()) continue;
    for (int32_t f = clique.first_factor; f >= 0; f = store_.factors[f].next) {
      const std::span<const int32_t> scope = store_.factors.scope(store_.factors[f]);
      if (std::find(scope.begin(), scope.end(), variable) != scope.end()) found.push_back(f);
    }
    store_.cliques.each_child(c, [&](int32_t child) { stack.push_back(child); });
  }
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<double> BayesTree::estimate(std::span<const int32_t> variables) {
  check_slots(variables);
  return steps_.estimate(variables);
}

std::vector<double> BayesTree::linearization_point(std::span<const int32_t> variables) const {
  check_slots(variables);
  std::vector<double> out;
  for (const int32_t v : variables)
    out.insert(out.end(), store_.variables.theta(v), store_.variables.theta(v) + store_.variables.storage(v));
  return out;
}

GroupCost BayesTree::cost() const {
  const TreeVariables& variables = store_.variables;
  std::vector<double> x(variables.all_theta().begin(), variables.all_theta().end());
  for (int32_t v = 0; variables.has_slot(v); ++v) variables.retract(v, variables.delta(v), x.data() + variables.theta_offset(v));
  return store_.factors.cost(x.data());
}

std::pair<std::vector<int32_t>, FactorGroup> BayesTree::factor_alone(int32_t f) const {
  if (!store_.factors.has({&f, 1})) throw std::invalid_argument("a factor that there is not");
  const std::span<const int32_t> scope = store_.factors.scope(store_.factors[f]);
  return {{scope.begin(), scope.end()}, store_.factors.alone(f)};
}

std::vector<double> BayesTree::squared(std::span<const int32_t> factors, uint32_t since) {
  if (!store_.factors.has(factors)) throw std::invalid_argument("a factor that there is not");
  std::vector<double> out;
  for (const int32_t f : factors) {
    const std::span<const int32_t> scope = store_.factors.scope(store_.factors[f]);
    const bool moved = std::any_of(scope.begin(), scope.end(), [&](int32_t v) { return store_.variables.changed(v) > since; });
    out.push_back(moved || since == 0 ? cost_of_group(store_.factors.alone(f), 0, 1, steps_.estimate(scope).data()).chi2 : -1.0);
  }
  return out;
}

std::vector<double> BayesTree::innovations(std::span<const int32_t> factors) {
  if (!store_.factors.has(factors)) throw std::invalid_argument("a factor that there is not");
  std::vector<double> out;
  for (const int32_t f : factors) {
    const TreeFactor& factor = store_.factors[f];
    const std::span<const int32_t> scope = store_.factors.scope(factor);
    const WhitenedFactor white = whitened(store_.factors.alone(f), steps_.estimate(scope));
    const Innovation found = innovation(white.r, TreeCovariance(store_).projected(scope, white.J), factor.let_go != 0);
    out.insert(out.end(), {found.squared, found.left});
  }
  return out;
}

std::vector<double> BayesTree::covariance(std::span<const int32_t> variables) const {
  check_slots(variables);
  return TreeCovariance(store_).blocks(variables);
}

std::vector<double> BayesTree::joint_covariance(std::span<const int32_t> variables) const {
  check_slots(variables);
  return TreeCovariance(store_).joint(variables);
}

StoredTree BayesTree::stored() {
  return {store_.variables.stored(), store_.factors.stored(),       store_.cliques.stored(), journal_.stored(),
          top_.stored(),             elimination_.stored_order(), steps_.stored(),         counts_};
}

std::vector<uint8_t> BayesTree::save() const {
  if (!idle()) throw std::invalid_argument("an update is under way; save between updates");
  return write_tree(const_cast<BayesTree*>(this)->stored());  // one list of members serves both ways; writing changes none
}

void BayesTree::load(std::span<const uint8_t> bytes) {
  if (slots() > 0 || store_.factors.has_kinds()) throw std::invalid_argument("only an empty tree can load a state");
  read_tree(stored(), bytes);
}

}  // namespace heliograph
