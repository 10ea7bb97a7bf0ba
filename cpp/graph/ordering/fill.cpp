// SPDX-License-Identifier: MIT
#include "graph/ordering/fill.hpp"

#include <algorithm>
#include <numeric>

namespace heliograph {

namespace {

constexpr int32_t kNone = -1;

std::vector<int32_t> inverse(std::span<const int32_t> order) {
  std::vector<int32_t> position(order.size());
  for (size_t k = 0; k < order.size(); ++k) position[order[k]] = static_cast<int32_t>(k);
  return position;
}

// Root of the tree that holds k, halving the paths on the way.
int32_t find(std::vector<int32_t>& ancestor, int32_t k) {
  while (ancestor[k] != k) k = ancestor[k] = ancestor[ancestor[k]];
  return k;
}

}  // namespace

std::vector<int32_t> elimination_tree(const Adjacency& graph, std::span<const int32_t> order) {
  const std::vector<int32_t> position = inverse(order);
  std::vector<int32_t> parent(order.size(), kNone);
  std::vector<int32_t> ancestor(order.size());  // shortcuts: path compression
  for (int32_t k = 0; k < static_cast<int32_t>(order.size()); ++k) {
    ancestor[k] = k;
    const int32_t node = order[k];
    for (int64_t p = graph.offset[node]; p < graph.offset[node + 1]; ++p) {
      const int32_t below = position[graph.neighbour[p]];
      if (below >= k) continue;
      const int32_t root = find(ancestor, below);
      if (root != k) parent[root] = ancestor[root] = k;
    }
  }
  return parent;
}

std::vector<int32_t> postorder(std::span<const int32_t> parent) {
  const auto n = static_cast<int32_t>(parent.size());
  std::vector<int32_t> child(parent.size(), kNone);
  std::vector<int32_t> sibling(parent.size(), kNone);
  for (int32_t k = n - 1; k >= 0; --k)
    if (parent[k] != kNone) {
      sibling[k] = child[parent[k]];
      child[parent[k]] = k;
    }
  std::vector<int32_t> out;
  out.reserve(parent.size());
  for (int32_t root = 0; root < n; ++root) {
    if (parent[root] != kNone) continue;
    int32_t k = root;
    while (k != kNone) {
      while (child[k] != kNone) k = child[k];
      out.push_back(k);
      while (k != root && sibling[k] == kNone) {  // all siblings done: the parent is next
        k = parent[k];
        out.push_back(k);
      }
      k = k == root ? kNone : sibling[k];
    }
  }
  return out;
}

// Row i of the factor is a subtree of the elimination tree, from i down to leaves among i's neighbours. A column's count
// is the number (here weight) of the subtrees it lies in: +w at each leaf, -w where two branches meet, -w above i,
// summed up the tree. Leaves are found in postorder: a neighbour is one if no earlier neighbour lies below it.
std::vector<int64_t> column_counts(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order,
                                   std::span<const int32_t> parent) {
  const size_t n = order.size();
  const std::vector<int32_t> position = inverse(order);
  const std::vector<int32_t> sequence = postorder(parent);
  const std::vector<int32_t> rank = inverse(sequence);
  std::vector<int32_t> first(n);              // rank of the first descendant
  std::vector<int32_t> previous_leaf(n, kNone);
  std::vector<int32_t> ancestor(n);
  std::vector<int64_t> count(n, 0);
  std::iota(ancestor.begin(), ancestor.end(), 0);
  for (size_t k = 0; k < n; ++k) first[k] = rank[k];
  for (const int32_t k : sequence) {
    if (first[k] == rank[k]) count[k] += weight[order[k]];
    if (parent[k] != kNone) first[parent[k]] = std::min(first[parent[k]], first[k]);
  }
  for (const int32_t k : sequence) {
    const int32_t node = order[k];
    if (parent[k] != kNone) count[parent[k]] -= weight[node];
    for (int64_t p = graph.offset[node]; p < graph.offset[node + 1]; ++p) {
      const int32_t i = position[graph.neighbour[p]];
      const int32_t earlier = i > k ? previous_leaf[i] : kNone;
      if (i <= k || (earlier != kNone && first[k] <= rank[earlier])) continue;
      const int64_t w = weight[order[i]];
      count[k] += w;
      if (earlier != kNone) count[find(ancestor, earlier)] -= w;
      previous_leaf[i] = k;
    }
    if (parent[k] != kNone) ancestor[k] = parent[k];
  }
  for (const int32_t k : sequence)
    if (parent[k] != kNone) count[parent[k]] += count[k];
  return count;
}

Fill fill_of_order(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order) {
  const std::vector<int32_t> parent = elimination_tree(graph, order);
  const std::vector<int64_t> count = column_counts(graph, weight, order, parent);
  Fill fill;
  for (size_t k = 0; k < order.size(); ++k) {
    const int64_t w = weight[order[k]];
    fill.nonzeros += w * count[k] - w * (w - 1) / 2;
    const auto c = static_cast<double>(count[k]);
    const auto b = static_cast<double>(w);
    // sum of (c - t)^2 for t = 0 .. w - 1
    fill.flops += b * c * c - c * b * (b - 1) + (b - 1) * b * (2 * b - 1) / 6;
  }
  return fill;
}

}  // namespace heliograph
