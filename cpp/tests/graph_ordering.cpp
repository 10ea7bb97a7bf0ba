// SPDX-License-Identifier: MIT
#include <algorithm>
#include <random>
#include <set>

#include "graph/ordering/fill.hpp"
#include "graph/ordering/ordering.hpp"
#include "tests/check.hpp"

namespace {

using heliograph::Adjacency;

Adjacency adjacency(int32_t n, const std::set<std::pair<int32_t, int32_t>>& edges) {
  std::set<std::pair<int32_t, int32_t>> both;
  for (const auto& [a, b] : edges) {
    if (a == b) continue;
    both.insert({a, b});
    both.insert({b, a});
  }
  Adjacency graph;
  graph.offset.assign(static_cast<size_t>(n) + 1, 0);
  for (const auto& [a, b] : both) {
    ++graph.offset[a + 1];
    graph.neighbour.push_back(b);
  }
  for (int32_t i = 0; i < n; ++i) graph.offset[i + 1] += graph.offset[i];
  return graph;
}

// Scalars of the factor, by joining all neighbours of each node in turn.
int64_t fill_slowly(const Adjacency& graph, const std::vector<int32_t>& weight, const std::vector<int32_t>& order) {
  std::vector<std::set<int32_t>> around(graph.size());
  for (size_t i = 0; i < graph.size(); ++i)
    around[i].insert(graph.neighbour.begin() + graph.offset[i], graph.neighbour.begin() + graph.offset[i + 1]);
  int64_t nonzeros = 0;
  for (const int32_t k : order) {
    nonzeros += int64_t{weight[k]} * (weight[k] + 1) / 2;
    for (const int32_t i : around[k]) {
      nonzeros += int64_t{weight[k]} * weight[i];
      around[i].insert(around[k].begin(), around[k].end());
      around[i].erase(i);
      around[i].erase(k);
    }
  }
  return nonzeros;
}

void check_orders(const Adjacency& graph, const std::vector<int32_t>& weight, const std::vector<int32_t>& group) {
  const auto free = heliograph::minimum_degree(graph, weight);
  const auto grouped = heliograph::minimum_degree(graph, weight, group);
  const auto dissected = heliograph::nested_dissection(graph, weight);
  for (const auto& order : {free, grouped, dissected}) {
    std::vector<int32_t> sorted = order;
    std::sort(sorted.begin(), sorted.end());
    CHECK(sorted.size() == graph.size());
    for (size_t i = 0; i < sorted.size(); ++i) CHECK(sorted[i] == static_cast<int32_t>(i));
    CHECK(heliograph::fill_of_order(graph, weight, order).nonzeros == fill_slowly(graph, weight, order));
  }
  for (size_t k = 1; k < grouped.size(); ++k) CHECK(group[grouped[k - 1]] <= group[grouped[k]]);
  CHECK(free == heliograph::minimum_degree(graph, weight));
  CHECK(dissected == heliograph::nested_dissection(graph, weight));
}

}  // namespace

void check_graph_ordering() {
  std::mt19937 random(7);
  for (int trial = 0; trial < 60; ++trial) {
    const auto n = static_cast<int32_t>(trial < 4 ? trial : random() % (trial < 50 ? 80 : 500) + 1);
    const double edges_a_node = 0.5 + static_cast<double>(random() % 40) / 10;
    std::set<std::pair<int32_t, int32_t>> edges;
    for (int k = 0; k < edges_a_node * n; ++k)
      edges.insert({static_cast<int32_t>(random() % n), static_cast<int32_t>(random() % n)});
    std::vector<int32_t> weight(static_cast<size_t>(n));
    std::vector<int32_t> group(static_cast<size_t>(n));
    for (int32_t& w : weight) w = static_cast<int32_t>(random() % 6) + 1;
    for (int32_t& g : group) g = static_cast<int32_t>(random() % 3) - 1;
    check_orders(adjacency(n, edges), weight, group);
  }
  std::set<std::pair<int32_t, int32_t>> star;
  std::set<std::pair<int32_t, int32_t>> grid;
  for (int32_t i = 1; i < 400; ++i) star.insert({0, i});
  for (int32_t i = 0; i < 900; ++i) {
    if (i % 30 != 29) grid.insert({i, i + 1});
    if (i + 30 < 900) grid.insert({i, i + 30});
  }
  check_orders(adjacency(400, star), std::vector<int32_t>(400, 3), std::vector<int32_t>(400, 0));
  check_orders(adjacency(900, grid), std::vector<int32_t>(900, 3), std::vector<int32_t>(900, 0));
}
