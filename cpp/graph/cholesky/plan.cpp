// SPDX-License-Identifier: MIT
#include "graph/cholesky/plan.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "graph/cholesky/plan_builder.hpp"
#include "graph/ordering/supernodes.hpp"

namespace heliograph {

namespace {

// Calls visit(group, factor, nodes of its variables), -1 for a variable that is held.
template <typename Visit>
void each_factor(std::span<const FactorGroup> groups, const Nodes& nodes, Visit&& visit) {
  std::array<int32_t, kMaxArity> scope{};
  for (const FactorGroup& group : groups)
    for (size_t i = 0; i < group.count; ++i) {
      const int32_t* variables = group.variables.data() + i * static_cast<size_t>(group.arity);
      for (int a = 0; a < group.arity; ++a)
        scope[static_cast<size_t>(a)] = nodes.node_of[static_cast<size_t>(variables[a])];
      visit(group, i, scope.data());
    }
}

}  // namespace

void tidy(Adjacency& graph) {
  int64_t write = 0, begin = 0;
  for (size_t i = 0; i < graph.size(); ++i) {
    const int64_t end = graph.offset[i + 1];
    const auto first = graph.neighbour.begin() + begin;
    std::sort(first, graph.neighbour.begin() + end);
    const auto last = std::unique(first, graph.neighbour.begin() + end);
    const int64_t count = last - first;
    std::copy(first, last, graph.neighbour.begin() + write);
    begin = end;
    write += count;
    graph.offset[i + 1] = write;
  }
  graph.neighbour.resize(static_cast<size_t>(write));
}

Adjacency adjacency_of(std::span<const FactorGroup> groups, const Nodes& nodes) {
  Adjacency graph;
  graph.offset.assign(nodes.weight.size() + 1, 0);
  const auto pairs = [&](auto&& visit) {
    each_factor(groups, nodes, [&](const FactorGroup& group, size_t, const int32_t* scope) {
      for (int a = 0; a < group.arity; ++a)
        for (int b = a + 1; b < group.arity; ++b)
          if (scope[a] >= 0 && scope[b] >= 0 && scope[a] != scope[b]) visit(scope[a], scope[b]);
    });
  };
  pairs([&](int32_t a, int32_t b) {
    ++graph.offset[static_cast<size_t>(a) + 1];
    ++graph.offset[static_cast<size_t>(b) + 1];
  });
  std::partial_sum(graph.offset.begin(), graph.offset.end(), graph.offset.begin());
  graph.neighbour.resize(static_cast<size_t>(graph.offset.back()));
  std::vector<int64_t> fill(graph.offset.begin(), graph.offset.end() - 1);
  pairs([&](int32_t a, int32_t b) {
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(a)]++)] = b;
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(b)]++)] = a;
  });
  tidy(graph);
  return graph;
}

Plan make_plan(std::span<const FactorGroup> groups, const double* blocks, const Nodes& nodes, const Adjacency& graph,
               std::span<const int32_t> order) {
  const auto each = [&](auto&& visit) {
    each_factor(groups, nodes, [&](const FactorGroup& group, size_t i, const int32_t* scope) {
      visit(group, blocks + group.block + i * block_size(group), scope);
    });
  };
  return PlanBuilder(each, nodes.weight, find_supernodes(graph, nodes.weight, order)).build();
}

}  // namespace heliograph
