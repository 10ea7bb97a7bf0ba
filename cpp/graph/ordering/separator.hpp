// SPDX-License-Identifier: MIT
// A vertex separator of a graph: grown, refined, and found through coarser copies of the graph. Used by nested dissection.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

namespace heliograph {

// A graph whose nodes and edges may stand for several of a finer one.
struct WeightedGraph {
  std::vector<int32_t> offset;       // (n + 1)
  std::vector<int32_t> neighbour;
  std::vector<int32_t> edge_weight;  // as neighbour: edges of the finest graph
  std::vector<int32_t> weight;       // (n)
  int32_t size() const { return static_cast<int32_t>(weight.size()); }
  int64_t total() const;
};

// Which part a node lies in. Parts 0 and 1 share no edge.
constexpr uint8_t kSeparator = 2;

// A division into two parts and a separator, and the moves that keep it one: a node leaves the separator for a part, and
// its neighbours in the other part enter the separator.
class Division {
 public:
  Division(const WeightedGraph& graph, std::vector<uint8_t>&& part);

  // Passes of best moves, each node once a pass, each pass taken back to its best moment.
  void refine();
  // Part 0 grows from a node until it has half of the weight; restarts elsewhere where a component ends. Expects all in
  // part 1.
  void grow(int32_t seed);

  // Smaller is better: the separator's weight, and the more so the less even the parts.
  double score() const;
  std::vector<uint8_t>& part() { return part_; }

 private:
  // Of equal gains the latest offer goes first: a front then advances in one place and not in specks.
  struct Move {
    int32_t gain;
    int32_t rank;
    int32_t node;
    bool operator<(const Move& other) const { return gain != other.gain ? gain < other.gain : rank < other.rank; }
  };
  enum class Direction : uint8_t { to_first, to_second, either };

  bool open(uint8_t to) const { return direction_ == Direction::either || static_cast<uint8_t>(direction_) == to; }
  int32_t gain(int32_t node, uint8_t to) const;
  void offer(int32_t node);
  void offer(int32_t node, uint8_t to);
  bool fresh(uint8_t to);
  int choose();
  void begin_pass(Direction direction);
  void move(int32_t node, uint8_t to);
  void set(int32_t node, uint8_t to);
  void back_to(size_t moment);
  bool pass(Direction direction);

  const WeightedGraph& graph_;
  std::vector<uint8_t> part_;
  std::array<int64_t, 3> weight_{};                 // of the parts and the separator
  int64_t limit_ = 0;                               // of a part's weight
  Direction direction_ = Direction::either;         // of this pass
  int32_t rank_ = 0;                                // of the latest offer
  std::array<std::vector<Move>, 2> heap_;           // moves to either part; entries go stale and are checked when on top
  std::vector<uint8_t> locked_;                     // nodes that have moved in this pass
  std::vector<std::pair<int32_t, uint8_t>> trail_;  // changes in this pass: node and where it was
};

// The part of each node, by multilevel bisection. Deterministic.
std::vector<uint8_t> separate(WeightedGraph&& graph);

}  // namespace heliograph
