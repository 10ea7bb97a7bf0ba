// SPDX-License-Identifier: MIT
// A static k-d tree: built once, balanced, points copied into leaf order so that a leaf is one run of memory.
#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace heliograph {

struct Neighbour {
  float square;    // squared distance [m^2]
  uint32_t index;  // in the points as they were given
};

// Nearer first; equal distances by index, so that the answer does not depend on the tree's shape.
inline bool operator<(const Neighbour& a, const Neighbour& b) {
  return a.square < b.square || (a.square == b.square && a.index < b.index);
}

constexpr uint32_t kNoNeighbour = ~uint32_t{0};

class KdTree {
 public:
  // Points that are not finite are left out.
  explicit KdTree(std::span<const float> points);

  // The nearest point whose squared distance is at most `max_square`; `hint` is a point likely near, or kNoNeighbour.
  Neighbour nearest(const float* query, float max_square, uint32_t hint = kNoNeighbour) const;

  // Up to `count` nearest within `max_square`, sorted, into `found` (room for `count`); returns how many.
  size_t nearest(const float* query, size_t count, float max_square, Neighbour* found) const;

  size_t size() const { return order_.size(); }
  size_t bytes() const;

 private:
  struct Node {
    float split;
    uint32_t begin, end;  // of its points in leaf order
    uint32_t right;       // the left child is the next node; 0: a leaf
    uint32_t leaf;        // its place in the leaves
    uint8_t axis;
  };
  uint32_t build(uint32_t begin, uint32_t end, std::span<const float> points);

  std::vector<Node> nodes_;
  std::vector<uint32_t> order_;  // leaf order -> index given
  // By leaf: x of its points, then y, then z, eight each, so that a leaf is one loop without a branch.
  static constexpr uint32_t kLeaf = 8;
  std::vector<float> leaves_;
  std::vector<float> given_;     // for hints: the points by index
  friend struct KdSearch;
};

}  // namespace heliograph
