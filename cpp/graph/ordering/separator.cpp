// SPDX-License-Identifier: MIT
// Sources: Fiduccia, Mattheyses, "A linear-time heuristic for improving network partitions", 1982, carried over to vertex
// separators by Hendrickson, Rothberg, "Improving the run time and quality of nested dissection ordering", 1998.
#include "graph/ordering/separator.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace heliograph {

namespace {

constexpr double kLargestPart = 0.6;     // of the weight
constexpr int kPasses = 4;
constexpr size_t kMostPatience = 4000;   // moves
constexpr double kUnevenness = 0.5;      // what the square of the relative difference of the parts costs

}  // namespace

int64_t WeightedGraph::total() const { return std::accumulate(weight.begin(), weight.end(), int64_t{0}); }

Division::Division(const WeightedGraph& graph, std::vector<uint8_t>&& part) : graph_(graph), part_(std::move(part)) {
  for (int32_t i = 0; i < graph.size(); ++i) weight_[part_[i]] += graph.weight[i];
  const int64_t total = weight_[0] + weight_[1] + weight_[2];
  const int32_t largest = graph.size() == 0 ? 0 : *std::max_element(graph.weight.begin(), graph.weight.end());
  limit_ = std::max(static_cast<int64_t>(kLargestPart * static_cast<double>(total)), total / 2 + largest);
  locked_.assign(part_.size(), 0);
}

double Division::score() const {
  const auto difference = static_cast<double>(std::abs(weight_[0] - weight_[1]));
  const double uneven = difference / (static_cast<double>(weight_[0] + weight_[1]) + 1.0);
  const auto excess = static_cast<double>(std::max<int64_t>(0, std::max(weight_[0], weight_[1]) - limit_));
  // The small number makes evenness count where no separator is needed at all.
  return (static_cast<double>(weight_[kSeparator]) + 1e-3) * (1.0 + kUnevenness * uneven * uneven) + excess;
}

// How much lighter the separator becomes when the node leaves it for a part.
int32_t Division::gain(int32_t node, uint8_t to) const {
  const auto other = static_cast<uint8_t>(1 - to);
  int32_t gain = graph_.weight[node];
  for (int32_t p = graph_.offset[node]; p < graph_.offset[node + 1]; ++p) {
    const int32_t j = graph_.neighbour[p];
    if (part_[j] == other) gain -= graph_.weight[j];
  }
  return gain;
}

void Division::offer(int32_t node, uint8_t to) {
  heap_[to].push_back({gain(node, to), ++rank_, node});
  std::push_heap(heap_[to].begin(), heap_[to].end());
}

void Division::offer(int32_t node) {
  for (const uint8_t to : {uint8_t{0}, uint8_t{1}})
    if (open(to)) offer(node, to);
}

// Brings a move that holds to the top of the heap; false if none is left.
bool Division::fresh(uint8_t to) {
  auto& heap = heap_[to];
  while (!heap.empty()) {
    const Move top = heap.front();
    const bool holds = part_[top.node] == kSeparator && !locked_[top.node];
    const int32_t now = holds ? gain(top.node, to) : 0;
    if (holds && now == top.gain) return true;
    std::pop_heap(heap.begin(), heap.end());
    heap.pop_back();
    if (holds && now < top.gain) {  // one that has grown was offered anew when it grew
      heap.push_back({now, top.rank, top.node});
      std::push_heap(heap.begin(), heap.end());
    }
  }
  return false;
}

void Division::set(int32_t node, uint8_t to) {
  trail_.emplace_back(node, part_[node]);
  weight_[part_[node]] -= graph_.weight[node];
  weight_[to] += graph_.weight[node];
  part_[node] = to;
}

void Division::move(int32_t node, uint8_t to) {
  const auto other = static_cast<uint8_t>(1 - to);
  set(node, to);
  locked_[node] = 1;
  for (int32_t p = graph_.offset[node]; p < graph_.offset[node + 1]; ++p) {
    const int32_t pulled = graph_.neighbour[p];
    if (part_[pulled] != other) continue;
    set(pulled, kSeparator);
    if (!locked_[pulled]) offer(pulled);
    for (int32_t q = graph_.offset[pulled]; q < graph_.offset[pulled + 1]; ++q) {
      const int32_t beside = graph_.neighbour[q];
      if (part_[beside] == kSeparator && !locked_[beside]) offer(beside, to);
    }
  }
}

void Division::back_to(size_t moment) {
  while (trail_.size() > moment) {
    const auto [node, was] = trail_.back();
    trail_.pop_back();
    weight_[part_[node]] -= graph_.weight[node];
    weight_[was] += graph_.weight[node];
    part_[node] = was;
  }
}

// The part that the best move goes to, -1 if there is none: the larger gain, then the lighter part.
int Division::choose() {
  std::array<bool, 2> possible{};
  for (const uint8_t to : {uint8_t{0}, uint8_t{1}})
    possible[to] = fresh(to) && weight_[to] + graph_.weight[heap_[to].front().node] <= limit_;
  if (!possible[0] && !possible[1]) return -1;
  if (!possible[0] || !possible[1]) return possible[0] ? 0 : 1;
  const int32_t a = heap_[0].front().gain;
  const int32_t b = heap_[1].front().gain;
  if (a != b) return a > b ? 0 : 1;
  return weight_[0] <= weight_[1] ? 0 : 1;
}

void Division::begin_pass(Direction direction) {
  direction_ = direction;
  rank_ = 0;
  heap_[0].clear();
  heap_[1].clear();
  trail_.clear();
  for (int32_t i = 0; i < graph_.size(); ++i)
    if (part_[i] == kSeparator) offer(i);
}

bool Division::pass(Direction direction) {
  begin_pass(direction);
  // A hill is climbed this far before the pass gives up: long enough for the whole separator to shift by a few nodes.
  const size_t patience = 20 + std::min<size_t>(4 * std::max(heap_[0].size(), heap_[1].size()), kMostPatience);
  const double before = score();
  double best = before;
  size_t best_moment = 0;
  size_t since = 0;
  std::vector<int32_t> moved;
  for (int to = choose(); to >= 0 && since < patience; to = choose()) {
    const int32_t node = heap_[to].front().node;
    moved.push_back(node);
    move(node, static_cast<uint8_t>(to));
    ++since;
    const double now = score();
    if (now < best) {
      best = now;
      best_moment = trail_.size();
      since = 0;
    }
  }
  back_to(best_moment);
  for (const int32_t node : moved) locked_[node] = 0;
  return best < before;
}

// Passes to one side push the separator across the graph like a front, which bends as it goes; moves to either side at
// once would only smooth it where it is. On grids this finds the slanted separators and saves a third of the flops.
void Division::refine() {
  bool first = weight_[0] <= weight_[1];
  int failed = 0;
  for (int k = 0; k < kPasses && failed < 2; ++k) {
    failed = pass(first ? Direction::to_first : Direction::to_second) ? 0 : failed + 1;
    first = !first;
  }
  pass(Direction::either);
}

void Division::grow(int32_t seed) {
  const int64_t half = (weight_[0] + weight_[1] + weight_[2]) / 2;
  direction_ = Direction::to_first;
  int32_t next = 0;  // where a new start is looked for once the component of the last one is used up
  set(seed, kSeparator);
  offer(seed, 0);
  while (weight_[0] + weight_[2] / 2 < half) {
    if (fresh(0)) {
      const int32_t node = heap_[0].front().node;
      move(node, 0);
      locked_[node] = 0;
      continue;
    }
    while (next < graph_.size() && part_[next] != 1) ++next;
    if (next == graph_.size()) break;
    set(next, kSeparator);
    offer(next, 0);
  }
}

}  // namespace heliograph
