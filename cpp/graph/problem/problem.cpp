// SPDX-License-Identifier: MIT
#include "graph/problem/problem.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "graph/ordering/fill.hpp"
#include "graph/ordering/ordering.hpp"
#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 512;  // factors that are summed together, whoever sums them

struct Chunk {
  size_t group = 0;
  size_t begin = 0;
  size_t end = 0;
};

std::vector<Chunk> chunks_of(const std::vector<FactorGroup>& groups) {
  std::vector<Chunk> chunks;
  for (size_t g = 0; g < groups.size(); ++g)
    for (size_t begin = 0; begin < groups[g].count; begin += kChunk)
      chunks.push_back({g, begin, std::min(begin + kChunk, groups[g].count)});
  return chunks;
}

// Runs `evaluate` on every chunk and adds the results in order.
template <typename Evaluate>
GroupCost sum_chunks(const std::vector<FactorGroup>& groups, int threads, Evaluate&& evaluate) {
  const std::vector<Chunk> chunks = chunks_of(groups);
  std::vector<GroupCost> costs(chunks.size());
  parallel_chunks(chunks.size(), threads, [&](size_t c) { costs[c] = evaluate(groups[chunks[c].group], chunks[c]); });
  GroupCost total;
  for (const GroupCost& cost : costs) {
    total.chi2 += cost.chi2;
    total.cost += cost.cost;
  }
  return total;
}

// Minimum degree, unless its factor costs so much that nested dissection, at some microseconds a node, may pay within the few
// factorisations of a solve; then whichever multiplies less.
std::vector<int32_t> cheaper_order(const Adjacency& graph, std::span<const int32_t> weight, OrderMethod* used) {
  constexpr double kWorthTrying = 2e4;  // multiplications a node
  constexpr size_t kSmall = 200;
  *used = OrderMethod::minimum_degree;
  std::vector<int32_t> order = minimum_degree(graph, weight);
  if (graph.size() <= kSmall) return order;
  const double flops = fill_of_order(graph, weight, order).flops;
  if (flops <= kWorthTrying * static_cast<double>(graph.size())) return order;
  std::vector<int32_t> other = nested_dissection(graph, weight);
  if (fill_of_order(graph, weight, other).flops >= flops) return order;
  *used = OrderMethod::nested_dissection;
  return other;
}

}  // namespace

GraphProblem::GraphProblem(std::vector<FamilyBlock> families) : families_(std::move(families)) {
  size_t value = 0, first = 0;
  for (FamilyBlock& family : families_) {
    family.storage = storage_of(family.manifold, family.dof);
    family.first = first;
    family.value = value;
    family.tangent = tangent_size_;
    for (size_t i = 0; i < family.count; ++i) {
      variable_tangent_.push_back(static_cast<int64_t>(tangent_size_ + i * static_cast<size_t>(family.dof)));
      variable_dof_.push_back(family.dof);
    }
    first += family.count;
    value += family.count * static_cast<size_t>(family.storage);
    tangent_size_ += family.count * static_cast<size_t>(family.dof);
  }
  values_.resize(value);
  candidate_.resize(value);
  step_.resize(tangent_size_);
  held_.resize(first);
}

size_t GraphProblem::add_group(FactorGroup group) {
  group.first_factor = factors_;
  group.block = block_doubles_;
  factors_ += group.count;
  block_doubles_ += group.count * block_size(group);
  groups_.push_back(std::move(group));
  return groups_.size() - 1;
}

void GraphProblem::hold(std::span<const int32_t> variables) {
  for (const int32_t v : variables) held_.at(static_cast<size_t>(v)) = 1;
}

void GraphProblem::set_values(std::span<const double> values) {
  if (values.size() != values_.size()) throw std::invalid_argument("values of another size");
  std::copy(values.begin(), values.end(), values_.begin());
}

void GraphProblem::set_step(std::span<const double> step) {
  if (step.size() != step_.size()) throw std::invalid_argument("a step of another size");
  std::copy(step.begin(), step.end(), step_.begin());
}

void GraphProblem::number_nodes() {
  nodes_ = Nodes{};
  nodes_.node_of.assign(held_.size(), -1);
  for (size_t v = 0; v < held_.size(); ++v) {
    if (held_[v] != 0) continue;
    nodes_.node_of[v] = static_cast<int32_t>(nodes_.variable_of.size());
    nodes_.variable_of.push_back(static_cast<int32_t>(v));
    nodes_.weight.push_back(variable_dof_[v]);
  }
}

void GraphProblem::make_plan_for(const Adjacency& graph, std::span<const int32_t> order) {
  multifrontal_.reset();
  blocks_.assign(block_doubles_, 0.0);
  plan_ = std::make_unique<Plan>(make_plan(groups_, blocks_.data(), nodes_, graph, order));
  multifrontal_.emplace(*plan_);
  elimination_.assign(static_cast<size_t>(plan_->scalars), 0.0);
}

void GraphProblem::analyze(OrderMethod method) {
  number_nodes();
  const Adjacency graph = adjacency_of(groups_, nodes_);
  std::vector<int32_t> order(nodes_.weight.size());
  std::iota(order.begin(), order.end(), 0);
  order_used_ = method;
  if (method == OrderMethod::automatic) {
    order = cheaper_order(graph, nodes_.weight, &order_used_);
  } else if (method == OrderMethod::minimum_degree) {
    order = minimum_degree(graph, nodes_.weight);
  } else if (method == OrderMethod::nested_dissection) {
    order = nested_dissection(graph, nodes_.weight);
  }
  make_plan_for(graph, order);
}

void GraphProblem::analyze_in(std::span<const int32_t> variables) {
  number_nodes();
  std::vector<int32_t> order;
  std::vector<uint8_t> taken(nodes_.weight.size(), 0);
  const auto take = [&](int32_t node) {
    if (node >= 0 && std::exchange(taken[static_cast<size_t>(node)], 1) == 0) order.push_back(node);
  };
  for (const int32_t v : variables) take(nodes_.node_of.at(static_cast<size_t>(v)));
  for (size_t node = 0; node < taken.size(); ++node) take(static_cast<int32_t>(node));
  order_used_ = OrderMethod::natural;
  make_plan_for(adjacency_of(groups_, nodes_), order);
}

std::vector<int32_t> GraphProblem::elimination_order() const {
  std::vector<int32_t> variables;
  for (const FrontView& front : plan().fronts)
    for (int32_t i = front.node_begin; i < front.node_begin + front.node_pivots; ++i)
      variables.push_back(nodes_.variable_of[static_cast<size_t>(plan_->nodes[static_cast<size_t>(i)])]);
  return variables;
}

const Plan& GraphProblem::plan() const {
  if (!plan_) throw std::logic_error("analyze first");
  return *plan_;
}

const Multifrontal& GraphProblem::factorization() const {
  if (!multifrontal_) throw std::logic_error("analyze first");
  return *multifrontal_;
}

GroupCost GraphProblem::linearize(int threads) {
  blocks_.resize(block_doubles_);  // they keep their place once there is a plan
  return sum_chunks(groups_, threads, [&](const FactorGroup& group, const Chunk& chunk) {
    double* blocks = blocks_.data() + group.block + chunk.begin * block_size(group);
    return linearize_group(group, chunk.begin, chunk.end, values_.data(), blocks);
  });
}

GroupCost GraphProblem::cost(bool at_candidate, int threads) const {
  const double* x = at_candidate ? candidate_.data() : values_.data();
  return sum_chunks(groups_, threads, [&](const FactorGroup& group, const Chunk& chunk) {
    return cost_of_group(group, chunk.begin, chunk.end, x);
  });
}

int64_t GraphProblem::factorize(double damping, double damping_floor, int threads) {
  plan();
  const int64_t failed = multifrontal_->factorize(damping, damping_floor, threads);
  if (failed < 0) return -1;
  for (size_t node = 0; node < nodes_.weight.size(); ++node) {
    const int64_t first = plan_->scalar_of[node];
    if (failed >= first && failed < first + nodes_.weight[node]) return nodes_.variable_of[node];
  }
  throw std::logic_error("a pivot outside the plan");
}

double GraphProblem::solve(double damping, double damping_floor) {
  // With (H + lambda D) d = -g the model falls by -2 g'd - d'H d = -g'd + lambda d'D d, and -g'd = |y|^2 with L y = g.
  factorization().solve(elimination_);
  scatter(elimination_, step_);
  const std::span<const double> diagonal = multifrontal_->diagonal();
  double damped = 0.0;
  for (size_t i = 0; i < elimination_.size(); ++i)
    damped += elimination_[i] * elimination_[i] * std::max(diagonal[i], damping_floor);
  return multifrontal_->gradient_energy() + damping * damped;
}

void GraphProblem::solve_for(std::span<double> columns) const {
  std::vector<double> b(static_cast<size_t>(plan().scalars));
  if (tangent_size_ == 0) return;
  for (size_t at = 0; at + tangent_size_ <= columns.size(); at += tangent_size_) {
    const std::span<double> column = columns.subspan(at, tangent_size_);
    gather(column, b);
    factorization().solve_for(b);
    scatter(b, column);
  }
}

void GraphProblem::scatter(std::span<const double> by_elimination, std::span<double> by_variable) const {
  std::fill(by_variable.begin(), by_variable.end(), 0.0);
  for (size_t node = 0; node < nodes_.weight.size(); ++node)
    std::copy_n(by_elimination.begin() + plan_->scalar_of[node], nodes_.weight[node],
                by_variable.begin() + variable_tangent_[static_cast<size_t>(nodes_.variable_of[node])]);
}

void GraphProblem::gather(std::span<const double> by_variable, std::span<double> by_elimination) const {
  for (size_t node = 0; node < nodes_.weight.size(); ++node)
    std::copy_n(by_variable.begin() + variable_tangent_[static_cast<size_t>(nodes_.variable_of[node])], nodes_.weight[node],
                by_elimination.begin() + plan_->scalar_of[node]);
}

std::vector<double> GraphProblem::gradient() const {
  std::vector<double> g(tangent_size_, 0.0);
  for (const FactorGroup& group : groups_) {
    const size_t size = block_size(group);
    size_t gradients = size;
    for (int a = 0; a < group.arity; ++a) gradients -= static_cast<size_t>(group.dof[static_cast<size_t>(a)]);
    for (size_t i = 0; i < group.count; ++i) {
      const double* from = blocks_.data() + group.block + i * size + gradients;
      for (int a = 0; a < group.arity; ++a) {
        const auto v = static_cast<size_t>(group.variables[i * static_cast<size_t>(group.arity) + static_cast<size_t>(a)]);
        double* to = g.data() + variable_tangent_[v];
        for (int k = 0; k < group.dof[static_cast<size_t>(a)]; ++k) to[k] += *from++;
      }
    }
  }
  for (size_t v = 0; v < held_.size(); ++v)
    if (held_[v] != 0) std::fill_n(g.begin() + variable_tangent_[v], variable_dof_[v], 0.0);
  return g;
}

std::vector<double> GraphProblem::diagonal() const {
  std::vector<double> out(tangent_size_);
  scatter(factorization().diagonal(), out);
  return out;
}

std::vector<double> GraphProblem::multiply(std::span<const double> v) const {
  if (v.size() != tangent_size_) throw std::invalid_argument("a vector of another size");
  std::vector<double> out(tangent_size_, 0.0);
  for (const FactorGroup& group : groups_) {
    const size_t size = block_size(group);
    for (size_t i = 0; i < group.count; ++i) {
      const double* h = blocks_.data() + group.block + i * size;
      const int32_t* scope = group.variables.data() + i * static_cast<size_t>(group.arity);
      for (int a = 0; a < group.arity; ++a)
        for (int b = a; b < group.arity; ++b) {
          const int rows = group.dof[static_cast<size_t>(a)], columns = group.dof[static_cast<size_t>(b)];
          const int64_t ta = variable_tangent_[static_cast<size_t>(scope[a])];
          const int64_t tb = variable_tangent_[static_cast<size_t>(scope[b])];
          for (int r = 0; r < rows; ++r)
            for (int c = 0; c < columns; ++c, ++h) {
              out[static_cast<size_t>(ta + r)] += *h * v[static_cast<size_t>(tb + c)];
              if (a != b) out[static_cast<size_t>(tb + c)] += *h * v[static_cast<size_t>(ta + r)];
            }
        }
    }
  }
  for (size_t k = 0; k < held_.size(); ++k)
    if (held_[k] != 0) std::fill_n(out.begin() + variable_tangent_[k], variable_dof_[k], 0.0);
  return out;
}

void GraphProblem::retract() {
  for (const FamilyBlock& family : families_) {
    retract_block(family, values_.data(), step_.data(), candidate_.data());
    // A step of zero may still round, but what is held keeps its bits.
    const auto storage = static_cast<size_t>(family.storage);
    for (size_t k = 0; k < family.count; ++k)
      if (held_[family.first + k] != 0)
        std::copy_n(values_.data() + family.value + k * storage, storage, candidate_.data() + family.value + k * storage);
  }
}

}  // namespace heliograph
