// SPDX-License-Identifier: MIT
// Source: Karypis, Kumar, "A fast and high quality multilevel scheme for partitioning irregular graphs", 1998.
#include <algorithm>
#include <deque>
#include <numeric>

#include "graph/ordering/separator.hpp"

namespace heliograph {

namespace {

constexpr int32_t kNone = -1;
constexpr int32_t kCoarsest = 60;     // nodes: small enough to try several seeds
constexpr double kStalled = 0.92;     // a level that shrinks less than this is the last
constexpr int kSeeds = 3;
constexpr size_t kReach = 512;        // of a swap

// The numbers below n, always in the same disorder: matching along the numbering of a grid would make stripes of it.
// Swaps reach only so far that they stay in the cache.
std::vector<int32_t> shuffled(size_t n) {
  std::vector<int32_t> sequence(n);
  std::iota(sequence.begin(), sequence.end(), 0);
  uint64_t state = 0x9E3779B97F4A7C15;
  for (size_t k = n; k > 1; --k) {
    state ^= state << 13;  // xorshift (Marsaglia 2003)
    state ^= state >> 7;
    state ^= state << 17;
    const size_t reach = std::min(k, kReach);
    std::swap(sequence[k - 1], sequence[k - 1 - static_cast<size_t>((state >> 32) * reach >> 32)]);
  }
  return sequence;
}

// Nodes by ascending degree: those with little choice are matched first.
std::vector<int32_t> by_degree(const WeightedGraph& graph) {
  constexpr int32_t top = 31;
  std::array<int32_t, top + 2> begin{};
  const auto bin = [&](int32_t i) { return std::min(graph.offset[i + 1] - graph.offset[i], top); };
  for (int32_t i = 0; i < graph.size(); ++i) ++begin[bin(i) + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<int32_t> sequence(graph.weight.size());
  for (const int32_t i : shuffled(sequence.size())) sequence[begin[bin(i)]++] = i;
  return sequence;
}

// The neighbour across the heaviest edge that is free and not too heavy; the lightest of equals.
int32_t partner(const WeightedGraph& graph, const std::vector<int32_t>& mate, int32_t i, int64_t heaviest) {
  int32_t best = kNone;
  int32_t edge = 0;
  for (int32_t p = graph.offset[i]; p < graph.offset[i + 1]; ++p) {
    const int32_t j = graph.neighbour[p];
    if (mate[j] != kNone || graph.weight[i] + graph.weight[j] > heaviest || graph.edge_weight[p] < edge) continue;
    if (graph.edge_weight[p] == edge && graph.weight[j] >= graph.weight[best]) continue;
    best = j;
    edge = graph.edge_weight[p];
  }
  return best;
}

// Leaves of one hub, and nodes without neighbours, have no partner across an edge: they pair up among themselves, or a
// star would never shrink.
void match_leaves(const WeightedGraph& graph, std::vector<int32_t>& mate, int64_t heaviest) {
  std::vector<int32_t> waiting(graph.weight.size() + 1, kNone);
  for (int32_t i = 0; i < graph.size(); ++i) {
    const int32_t degree = graph.offset[i + 1] - graph.offset[i];
    if (mate[i] != kNone || degree > 2) continue;
    int32_t& other = waiting[degree == 0 ? graph.size() : graph.neighbour[graph.offset[i]]];
    if (other != kNone && graph.weight[i] + graph.weight[other] <= heaviest) {
      mate[i] = other;
      mate[other] = i;
      other = kNone;
    } else {
      other = i;
    }
  }
}

// The coarse node of each node, and how many there are.
std::pair<std::vector<int32_t>, int32_t> match(const WeightedGraph& graph, int64_t heaviest) {
  std::vector<int32_t> mate(graph.weight.size(), kNone);
  int32_t free_nodes = 0;
  for (const int32_t i : by_degree(graph)) {
    if (mate[i] != kNone) continue;
    const int32_t j = partner(graph, mate, i, heaviest);
    if (j == kNone) {
      ++free_nodes;
      continue;
    }
    mate[i] = j;
    mate[j] = i;
  }
  if (free_nodes * 10 > graph.size()) match_leaves(graph, mate, heaviest);
  std::vector<int32_t> coarse(graph.weight.size());
  int32_t count = 0;
  for (int32_t i = 0; i < graph.size(); ++i)
    coarse[i] = mate[i] != kNone && mate[i] < i ? coarse[mate[i]] : count++;
  return {std::move(coarse), count};
}

WeightedGraph contract(const WeightedGraph& fine, const std::vector<int32_t>& coarse, int32_t count) {
  WeightedGraph graph;
  graph.offset.reserve(static_cast<size_t>(count) + 1);
  graph.offset.push_back(0);
  graph.neighbour.reserve(fine.neighbour.size());
  graph.edge_weight.reserve(fine.neighbour.size());
  graph.weight.assign(static_cast<size_t>(count), 0);
  std::vector<std::array<int32_t, 2>> members(static_cast<size_t>(count), {kNone, kNone});
  for (int32_t i = 0; i < fine.size(); ++i) {
    auto& pair = members[coarse[i]];
    pair[pair[0] == kNone ? 0 : 1] = i;
    graph.weight[coarse[i]] += fine.weight[i];
  }
  std::vector<int32_t> place(static_cast<size_t>(count), kNone);  // where a neighbour stands in the row being written
  for (int32_t c = 0; c < count; ++c) {
    const auto begin = static_cast<int32_t>(graph.neighbour.size());
    for (const int32_t i : members[c]) {
      if (i == kNone) continue;
      for (int32_t p = fine.offset[i]; p < fine.offset[i + 1]; ++p) {
        const int32_t j = coarse[fine.neighbour[p]];
        if (j == c) continue;
        if (place[j] >= begin) {
          graph.edge_weight[place[j]] += fine.edge_weight[p];
          continue;
        }
        place[j] = static_cast<int32_t>(graph.neighbour.size());
        graph.neighbour.push_back(j);
        graph.edge_weight.push_back(fine.edge_weight[p]);
      }
    }
    graph.offset.push_back(static_cast<int32_t>(graph.neighbour.size()));
  }
  return graph;
}

// The last node that a search by breadth reaches.
int32_t farthest(const WeightedGraph& graph, int32_t from) {
  std::vector<uint8_t> seen(graph.weight.size(), 0);
  std::vector<int32_t> queue{from};
  seen[from] = 1;
  for (size_t k = 0; k < queue.size(); ++k)
    for (int32_t p = graph.offset[queue[k]]; p < graph.offset[queue[k] + 1]; ++p) {
      const int32_t j = graph.neighbour[p];
      if (seen[j]) continue;
      seen[j] = 1;
      queue.push_back(j);
    }
  return queue.back();
}

// The best of several grown and refined divisions. They start at the ends of the graph: of one of its longest ways, and
// far from nodes spread over the numbering.
std::vector<uint8_t> divide_coarsest(const WeightedGraph& graph) {
  std::vector<uint8_t> best;
  double least = 0;
  const int32_t n = graph.size();
  int32_t seed = 0;
  for (int k = 0; k < kSeeds; ++k) {
    const auto spread = static_cast<int32_t>((2 * int64_t{k} + 1) * n / (2 * kSeeds));
    seed = farthest(graph, k % 2 == 1 ? seed : spread);
    Division division(graph, std::vector<uint8_t>(static_cast<size_t>(n), 1));
    division.grow(seed);
    division.refine();
    if (!best.empty() && division.score() >= least) continue;
    least = division.score();
    best = std::move(division.part());
  }
  return best;
}

}  // namespace

std::vector<uint8_t> separate(WeightedGraph&& graph) {
  std::deque<WeightedGraph> level;
  std::vector<std::vector<int32_t>> coarse;
  level.push_back(std::move(graph));
  const int64_t heaviest = std::max<int64_t>(1, 3 * level.front().total() / (2 * kCoarsest));
  while (level.back().size() > kCoarsest) {
    auto [map, count] = match(level.back(), heaviest);
    if (count > kStalled * level.back().size()) break;
    level.push_back(contract(level.back(), map, count));
    coarse.push_back(std::move(map));
  }
  std::vector<uint8_t> part = divide_coarsest(level.back());
  for (size_t k = coarse.size(); k-- > 0;) {
    level.pop_back();
    std::vector<uint8_t> finer(coarse[k].size());
    for (size_t i = 0; i < finer.size(); ++i) finer[i] = part[coarse[k][i]];
    Division division(level.back(), std::move(finer));
    division.refine();
    part = std::move(division.part());
  }
  return part;
}

}  // namespace heliograph
