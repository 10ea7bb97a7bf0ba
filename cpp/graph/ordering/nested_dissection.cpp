// SPDX-License-Identifier: MIT
// Nested dissection: the separators only decide which nodes must wait for which. One run of the minimum degree
// algorithm with these groups then orders everything, so that the inside of a part is ordered with its surroundings known.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "graph/ordering/ordering.hpp"
#include "graph/ordering/separator.hpp"

namespace heliograph {

namespace {

constexpr int32_t kNone = -1;
constexpr size_t kLeaf = 200;      // nodes: minimum degree does as well below
constexpr int32_t kHub = 16;      // neighbours: more, and replacing one of them is not worth the search

// The graph without its chains: nodes with at most two neighbours go first in any good order, and two neighbours become
// one edge. Long stretches of odometry vanish, and what is left to divide is the graph of the loops.
class Kernel {
 public:
  explicit Kernel(const Adjacency& graph);
  // Adjacency among `nodes` only; `local` is scratch, kNone on entry and exit.
  WeightedGraph part(std::span<const int32_t> nodes, std::span<const int32_t> weight, std::vector<int32_t>& local) const;
  std::vector<int32_t> nodes() const;

 private:
  void eliminate(int32_t i, std::vector<int32_t>& queue);
  void replace(int32_t i, int32_t old_neighbour, int32_t new_neighbour);
  bool sees(int32_t i, int32_t j) const;

  std::vector<int64_t> begin_;
  std::vector<int32_t> degree_;
  std::vector<int32_t> neighbour_;
  std::vector<uint8_t> gone_;
};

Kernel::Kernel(const Adjacency& graph) : neighbour_(graph.neighbour) {
  const size_t n = graph.size();
  begin_.assign(graph.offset.begin(), graph.offset.begin() + static_cast<std::ptrdiff_t>(n));
  degree_.resize(n);
  gone_.assign(n, 0);
  for (size_t i = 0; i < n; ++i) degree_[i] = static_cast<int32_t>(graph.offset[i + 1] - graph.offset[i]);
  std::vector<int32_t> queue;
  for (size_t i = 0; i < n; ++i) {
    queue.push_back(static_cast<int32_t>(i));
    while (!queue.empty()) {
      const int32_t node = queue.back();
      queue.pop_back();
      if (!gone_[node] && degree_[node] <= 2) eliminate(node, queue);
    }
  }
}

bool Kernel::sees(int32_t i, int32_t j) const {
  const auto first = neighbour_.begin() + begin_[i];
  return std::find(first, first + degree_[i], j) != first + degree_[i];
}

// Puts a new neighbour in an old one's place, or takes the old one out (kNone).
void Kernel::replace(int32_t i, int32_t old_neighbour, int32_t new_neighbour) {
  const auto first = neighbour_.begin() + begin_[i];
  const auto found = std::find(first, first + degree_[i], old_neighbour);
  if (new_neighbour == kNone) {
    *found = *(first + degree_[i] - 1);
    --degree_[i];
  } else {
    *found = new_neighbour;
  }
}

void Kernel::eliminate(int32_t i, std::vector<int32_t>& queue) {
  const int32_t* around = neighbour_.data() + begin_[i];
  const int32_t degree = degree_[i];
  for (int32_t k = 0; k < degree; ++k)
    if (degree_[around[k]] > kHub) return;
  gone_[i] = 1;
  if (degree == 2) {
    const bool known = sees(around[0], around[1]);
    replace(around[0], i, known ? kNone : around[1]);
    replace(around[1], i, known ? kNone : around[0]);
  } else if (degree == 1) {
    replace(around[0], i, kNone);
  }
  for (int32_t k = 0; k < degree; ++k)
    if (degree_[around[k]] <= 2) queue.push_back(around[k]);
}

// What is left, without the nodes that see most of the others.
std::vector<int32_t> Kernel::nodes() const {
  std::vector<int32_t> left;
  for (size_t i = 0; i < gone_.size(); ++i)
    if (!gone_[i]) left.push_back(static_cast<int32_t>(i));
  const auto limit = static_cast<int32_t>(std::max(16.0, 10.0 * std::sqrt(static_cast<double>(left.size()))));
  std::erase_if(left, [&](int32_t i) { return degree_[i] > limit; });
  return left;
}

WeightedGraph Kernel::part(std::span<const int32_t> nodes, std::span<const int32_t> weight, std::vector<int32_t>& local) const {
  WeightedGraph graph;
  graph.offset.reserve(nodes.size() + 1);
  graph.weight.reserve(nodes.size());
  graph.offset.push_back(0);
  size_t entries = 0;
  for (size_t k = 0; k < nodes.size(); ++k) {
    local[nodes[k]] = static_cast<int32_t>(k);
    entries += static_cast<size_t>(degree_[nodes[k]]);
  }
  graph.neighbour.reserve(entries);
  for (const int32_t i : nodes) {
    for (int64_t p = begin_[i]; p < begin_[i] + degree_[i]; ++p)
      if (local[neighbour_[p]] != kNone) graph.neighbour.push_back(local[neighbour_[p]]);
    graph.offset.push_back(static_cast<int32_t>(graph.neighbour.size()));
    graph.weight.push_back(weight[i]);
  }
  graph.edge_weight.assign(graph.neighbour.size(), 1);
  for (const int32_t i : nodes) local[i] = kNone;
  return graph;
}

struct Part {
  size_t begin;
  size_t end;
  int32_t depth;
};

// Depth of the separator that holds each node, kNone if none does.
std::vector<int32_t> dissect(const Kernel& kernel, std::span<const int32_t> weight) {
  std::vector<int32_t> depth(weight.size(), kNone);
  std::vector<int32_t> local(weight.size(), kNone);
  std::vector<int32_t> nodes = kernel.nodes();
  std::vector<int32_t> other;
  std::vector<Part> stack{{0, nodes.size(), 0}};
  while (!stack.empty()) {
    const Part here = stack.back();
    stack.pop_back();
    if (here.end - here.begin <= kLeaf) continue;
    const std::span<int32_t> range(nodes.data() + here.begin, here.end - here.begin);
    const std::vector<uint8_t> part = separate(kernel.part(range, weight, local));
    // Part 0 to the front, part 1 behind it, each in its order; the separator drops out.
    other.clear();
    std::array<size_t, 3> count{};
    for (size_t k = 0; k < range.size(); ++k) ++count[part[k]];
    if (count[0] == 0 || count[1] == 0 || count[2] * 2 > range.size()) continue;  // next to a clique: nothing to win
    size_t front = here.begin;
    for (size_t k = 0; k < part.size(); ++k) {
      const int32_t i = nodes[here.begin + k];
      if (part[k] == 0) nodes[front++] = i;
      if (part[k] == 1) other.push_back(i);
      if (part[k] == kSeparator) depth[i] = here.depth;
    }
    std::copy(other.begin(), other.end(), nodes.begin() + static_cast<std::ptrdiff_t>(front));
    stack.push_back({front, front + other.size(), here.depth + 1});
    stack.push_back({here.begin, front, here.depth + 1});
  }
  return depth;
}

}  // namespace

std::vector<int32_t> nested_dissection(const Adjacency& graph, std::span<const int32_t> weight) {
  if (weight.size() != graph.size()) throw std::invalid_argument("an ordering needs one weight a node");
  std::vector<int32_t> group = dissect(Kernel(graph), weight);
  const int32_t deepest = group.empty() ? kNone : *std::max_element(group.begin(), group.end());
  for (int32_t& g : group) g = g == kNone ? 0 : deepest - g + 1;
  return minimum_degree(graph, weight, group);
}

}  // namespace heliograph
