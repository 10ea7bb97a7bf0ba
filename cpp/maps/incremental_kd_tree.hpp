// SPDX-License-Identifier: MIT
// A k-d tree that points are added to and removed from: exact neighbours at any time, work in proportion to what changes.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "maps/kd_tree.hpp"

namespace heliograph {

// Points lie in leaves of up to 32, coordinates apart, so that a leaf is scanned without a branch a point. Leaves that
// overflow split at their median. A subtree whose heavier side holds more than `balance` of its points is built anew
// when a point passes through it: the cost of that is paid by the insertions that unbalanced it (A. Andersson, "General
// balanced trees", J. Algorithms 1999; for a moving sensor: Y. Cai, W. Xu, F. Zhang, "ikd-Tree", arXiv 2102.10808).
// Removal is at once, not by marks: a cell that lies wholly inside what goes is freed without looking at its points.
class IncrementalKdTree {
 public:
  // `spacing`: edge of the cubes of which each keeps one point, chosen by its rank [m]; 0 keeps all.
  IncrementalKdTree(double spacing, double balance);

  // Adds finite points (others are skipped); returns how many the tree holds more than before.
  size_t insert(std::span<const float> points);

  size_t remove_box(const float* low, const float* high);            // what lies inside, ends included
  size_t remove_beyond(const float* centre, float radius);           // what lies farther
  void clear();

  // Up to `count` nearest within `max_square`, sorted by distance, then by coordinates; `found` receives squared
  // distances and `places` the points, 3 floats each. Returns how many.
  size_t nearest(const float* query, size_t count, float max_square, float* found, float* places) const;
  bool any_in_box(const float* low, const float* high) const;

  size_t size() const { return root_ == kNone ? 0 : nodes_[root_].count; }
  size_t bytes() const;
  size_t depth() const { return root_ == kNone ? 0 : depth_of(root_); }
  std::vector<float> points() const;

  static constexpr size_t kLeaf = 32;

 private:
  static constexpr uint32_t kNone = ~uint32_t{0};
  struct Leaf {
    std::array<std::array<float, kLeaf>, 3> at;
  };
  struct Node {
    float split;
    uint32_t count;       // of points below
    uint32_t left, right; // children; of a leaf: its leaf, kNone
    uint8_t axis;
    bool is_leaf() const { return right == kNone; }
  };
  struct Cell {
    float low[3], high[3];
  };
  using Point = std::array<float, 3>;
  struct Search;

  uint32_t new_node();
  uint32_t new_leaf();
  uint32_t build(Point* begin, Point* end);
  void collect(uint32_t node, std::vector<Point>* out) const;
  void release(uint32_t node);
  void add(const Point& point);
  bool thin_out(const Point& point);
  bool erase_exactly(const Point& point);
  template <typename Test>
  uint32_t remove(uint32_t node, const Cell& cell, const Test& test);
  void rebuild(uint32_t* link);
  void split_leaf(uint32_t node);
  size_t depth_of(uint32_t node) const;
  template <typename Visit>
  void visit_box(uint32_t node, const float* low, const float* high, const Visit& visit) const;

  double spacing_, balance_;
  uint32_t root_ = kNone;
  std::vector<Node> nodes_;
  std::vector<Leaf> leaves_;
  std::vector<uint32_t> free_nodes_, free_leaves_;
};

}  // namespace heliograph
