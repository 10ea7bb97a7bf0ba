// SPDX-License-Identifier: MIT
#include "maps/kd_tree.hpp"

#include <algorithm>
#include <cmath>

namespace heliograph {

namespace {

float square_distance(const float* a, const float* b) {
  const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

}  // namespace

KdTree::KdTree(std::span<const float> points) : given_(points.begin(), points.end()) {
  const size_t count = points.size() / 3;
  order_.reserve(count);
  for (size_t i = 0; i < count; ++i)
    if (std::isfinite(points[3 * i] + points[3 * i + 1] + points[3 * i + 2])) order_.push_back(static_cast<uint32_t>(i));
  if (order_.empty()) return;
  nodes_.reserve(2 * order_.size() / kLeaf + 2);
  build(0, static_cast<uint32_t>(order_.size()), points);
}

uint32_t KdTree::build(uint32_t begin, uint32_t end, std::span<const float> points) {
  const auto at = static_cast<uint32_t>(nodes_.size());
  nodes_.push_back({0.0F, begin, end, 0, 0, 0});
  if (end - begin <= kLeaf) {
    nodes_[at].leaf = static_cast<uint32_t>(leaves_.size());
    leaves_.resize(leaves_.size() + 3 * kLeaf, std::numeric_limits<float>::infinity());
    float* leaf = leaves_.data() + nodes_[at].leaf;
    for (uint32_t i = begin; i < end; ++i)
      for (uint32_t k = 0; k < 3; ++k) leaf[k * kLeaf + i - begin] = points[3 * size_t{order_[i]} + k];
    return at;
  }
  float low[3], high[3];
  std::fill_n(low, 3, std::numeric_limits<float>::max());
  std::fill_n(high, 3, std::numeric_limits<float>::lowest());
  for (uint32_t i = begin; i < end; ++i)
    for (int k = 0; k < 3; ++k) {
      const float x = points[3 * size_t{order_[i]} + static_cast<size_t>(k)];
      low[k] = std::min(low[k], x);
      high[k] = std::max(high[k], x);
    }
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
  const uint32_t middle = begin + (end - begin) / 2;
  const auto value = [&](uint32_t i) { return points[3 * size_t{i} + static_cast<size_t>(axis)]; };
  std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end, [&](uint32_t a, uint32_t b) {
    return value(a) < value(b) || (value(a) == value(b) && a < b);
  });
  const float split = value(order_[middle]);
  build(begin, middle, points);
  const uint32_t right = build(middle, end, points);
  nodes_[at].split = split;
  nodes_[at].right = right;
  nodes_[at].axis = static_cast<uint8_t>(axis);
  return at;
}

// Depth first, the nearer child first; the squared distance to a child's cell grows axis by axis (S. Arya, D. Mount,
// "Algorithms for fast vector quantization", DCC 1993).
struct KdSearch {
  const KdTree& tree;
  const float* query;
  Neighbour* found;
  size_t wanted;
  size_t count;
  Neighbour worst;

  void offer(const Neighbour& candidate) {
    if (!(candidate < worst)) return;
    size_t at = count < wanted ? count++ : wanted - 1;
    for (; at > 0 && candidate < found[at - 1]; --at) found[at] = found[at - 1];
    found[at] = candidate;
    if (count == wanted) worst = found[wanted - 1];
  }

  void visit(uint32_t node, float* aside, float square) {
    const KdTree::Node& n = tree.nodes_[node];
    if (n.right == 0) {
      const float* leaf = tree.leaves_.data() + n.leaf;
      float d[KdTree::kLeaf];
      for (uint32_t i = 0; i < KdTree::kLeaf; ++i) {
        const float x = leaf[i] - query[0], y = leaf[KdTree::kLeaf + i] - query[1], z = leaf[2 * KdTree::kLeaf + i] - query[2];
        d[i] = x * x + y * y + z * z;
      }
      for (uint32_t i = n.begin; i < n.end; ++i)
        if (d[i - n.begin] <= worst.square) offer({d[i - n.begin], tree.order_[i]});
      return;
    }
    const float offset = query[n.axis] - n.split;
    const uint32_t near = offset < 0.0F ? node + 1 : n.right, far = offset < 0.0F ? n.right : node + 1;
    visit(near, aside, square);
    const float old = aside[n.axis], beyond = square - old * old + offset * offset;
    // The margin keeps rounding of `beyond` from cutting off an equal point.
    if (beyond * 0.99999F > worst.square) return;
    aside[n.axis] = offset;
    visit(far, aside, beyond);
    aside[n.axis] = old;
  }
};

Neighbour KdTree::nearest(const float* query, float max_square, uint32_t hint) const {
  Neighbour best{max_square, kNoNeighbour};
  if (nodes_.empty()) return best;
  if (hint != kNoNeighbour) {
    const float d = square_distance(given_.data() + 3 * size_t{hint}, query);
    if (d <= max_square) best = {d, hint};
  }
  Neighbour found[1] = {best};
  KdSearch search{*this, query, found, 1, size_t{best.index != kNoNeighbour}, best};
  float aside[3] = {0.0F, 0.0F, 0.0F};
  search.visit(0, aside, 0.0F);
  return search.count > 0 ? found[0] : best;
}

size_t KdTree::nearest(const float* query, size_t count, float max_square, Neighbour* found) const {
  if (nodes_.empty() || count == 0) return 0;
  KdSearch search{*this, query, found, count, 0, {max_square, kNoNeighbour}};
  float aside[3] = {0.0F, 0.0F, 0.0F};
  search.visit(0, aside, 0.0F);
  return search.count;
}

size_t KdTree::bytes() const {
  return nodes_.capacity() * sizeof(Node) + order_.capacity() * sizeof(uint32_t) +
         (leaves_.capacity() + given_.capacity()) * sizeof(float);
}

}  // namespace heliograph
