// SPDX-License-Identifier: MIT
#include "maps/incremental_kd_tree.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "util/point_rank.hpp"

namespace heliograph {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr uint32_t kSmall = 4 * IncrementalKdTree::kLeaf;  // a subtree of fewer points is not worth balancing

bool inside(const std::array<float, 3>& p, const float* low, const float* high) {
  return p[0] >= low[0] && p[0] <= high[0] && p[1] >= low[1] && p[1] <= high[1] && p[2] >= low[2] && p[2] <= high[2];
}

}  // namespace

IncrementalKdTree::IncrementalKdTree(double spacing, double balance) : spacing_(spacing), balance_(balance) {}

uint32_t IncrementalKdTree::new_node() {
  if (free_nodes_.empty()) {
    nodes_.push_back({});
    return static_cast<uint32_t>(nodes_.size() - 1);
  }
  const uint32_t at = free_nodes_.back();
  free_nodes_.pop_back();
  return at;
}

uint32_t IncrementalKdTree::new_leaf() {
  if (free_leaves_.empty()) {
    leaves_.push_back({});
    return static_cast<uint32_t>(leaves_.size() - 1);
  }
  const uint32_t at = free_leaves_.back();
  free_leaves_.pop_back();
  return at;
}

void IncrementalKdTree::clear() {
  nodes_.clear();
  leaves_.clear();
  free_nodes_.clear();
  free_leaves_.clear();
  root_ = kNone;
}

uint32_t IncrementalKdTree::build(Point* begin, Point* end) {
  const auto count = static_cast<size_t>(end - begin);
  const uint32_t at = new_node();
  Point low, high;
  low.fill(kInfinity);
  high.fill(-kInfinity);
  for (const Point* p = begin; p != end; ++p)
    for (size_t k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], (*p)[k]);
      high[k] = std::max(high[k], (*p)[k]);
    }
  size_t axis = 0;
  for (size_t k = 1; k < 3; ++k)
    if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
  // Half full, so that the next points find room.
  if (count <= kLeaf / 2 || (count <= kLeaf && !(high[axis] > low[axis]))) {
    const uint32_t leaf = new_leaf();
    for (size_t i = 0; i < count; ++i)
      for (size_t k = 0; k < 3; ++k) leaves_[leaf].at[k][i] = begin[i][k];
    nodes_[at] = {0.0F, static_cast<uint32_t>(count), leaf, kNone, 0};
    return at;
  }
  Point* middle = begin + count / 2;
  std::nth_element(begin, middle, end, [axis](const Point& a, const Point& b) { return a[axis] < b[axis] || (a[axis] == b[axis] && a < b); });
  const float split = (*middle)[axis];
  const uint32_t left = build(begin, middle), right = build(middle, end);
  nodes_[at] = {split, static_cast<uint32_t>(count), left, right, static_cast<uint8_t>(axis)};
  return at;
}

void IncrementalKdTree::collect(uint32_t node, std::vector<Point>* out) const {
  const Node& n = nodes_[node];
  if (!n.is_leaf()) {
    collect(n.left, out);
    collect(n.right, out);
    return;
  }
  const Leaf& leaf = leaves_[n.left];
  for (uint32_t i = 0; i < n.count; ++i) out->push_back({leaf.at[0][i], leaf.at[1][i], leaf.at[2][i]});
}

void IncrementalKdTree::release(uint32_t node) {
  const Node n = nodes_[node];
  if (n.is_leaf()) {
    free_leaves_.push_back(n.left);
  } else {
    release(n.left);
    release(n.right);
  }
  free_nodes_.push_back(node);
}

void IncrementalKdTree::rebuild(uint32_t* link) {
  std::vector<Point> points;
  points.reserve(nodes_[*link].count);
  collect(*link, &points);
  release(*link);
  *link = build(points.data(), points.data() + points.size());
}

void IncrementalKdTree::split_leaf(uint32_t node) {
  std::vector<Point> points;
  collect(node, &points);
  const size_t half = points.size() / 2;
  size_t axis = 0;
  float widest = -1.0F;
  for (size_t k = 0; k < 3; ++k) {
    const auto [low, high] = std::minmax_element(points.begin(), points.end(), [k](const Point& a, const Point& b) { return a[k] < b[k]; });
    if ((*high)[k] - (*low)[k] > widest) {
      widest = (*high)[k] - (*low)[k];
      axis = k;
    }
  }
  std::nth_element(points.begin(), points.begin() + static_cast<std::ptrdiff_t>(half), points.end(),
                   [axis](const Point& a, const Point& b) { return a[axis] < b[axis] || (a[axis] == b[axis] && a < b); });
  const float split = points[half][axis];
  const uint32_t first = nodes_[node].left, second = new_leaf(), left = new_node(), right = new_node();
  for (size_t i = 0; i < points.size(); ++i) {
    Leaf& leaf = leaves_[i < half ? first : second];
    for (size_t k = 0; k < 3; ++k) leaf.at[k][i < half ? i : i - half] = points[i][k];
  }
  const auto total = static_cast<uint32_t>(points.size()), low = static_cast<uint32_t>(half);
  nodes_[left] = {0.0F, low, first, kNone, 0};
  nodes_[right] = {0.0F, total - low, second, kNone, 0};
  nodes_[node] = {split, total, left, right, static_cast<uint8_t>(axis)};
}

void IncrementalKdTree::add(const Point& point) {
  if (root_ == kNone) {
    const uint32_t leaf = new_leaf();
    root_ = new_node();
    nodes_[root_] = {0.0F, 0, leaf, kNone, 0};
  }
  uint32_t parent = kNone, unbalanced_parent = kNone, unbalanced = kNone, at = root_;
  while (!nodes_[at].is_leaf()) {
    Node& n = nodes_[at];
    ++n.count;
    const uint32_t heavier = std::max(nodes_[n.left].count, nodes_[n.right].count);
    if (unbalanced == kNone && n.count > kSmall && static_cast<double>(heavier) > balance_ * static_cast<double>(n.count)) {
      unbalanced = at;
      unbalanced_parent = parent;
    }
    parent = at;
    at = point[n.axis] < n.split ? n.left : n.right;
  }
  if (nodes_[at].count == kLeaf) {
    split_leaf(at);
    Node& n = nodes_[at];
    ++n.count;
    at = point[n.axis] < n.split ? n.left : n.right;
  }
  Node& n = nodes_[at];
  for (size_t k = 0; k < 3; ++k) leaves_[n.left].at[k][n.count] = point[k];
  ++n.count;
  if (unbalanced == kNone) return;
  uint32_t link = unbalanced;
  rebuild(&link);
  if (unbalanced_parent == kNone)
    root_ = link;
  else if (nodes_[unbalanced_parent].left == unbalanced)
    nodes_[unbalanced_parent].left = link;
  else
    nodes_[unbalanced_parent].right = link;
}

template <typename Visit>
void IncrementalKdTree::visit_box(uint32_t node, const float* low, const float* high, const Visit& visit) const {
  const Node& n = nodes_[node];
  if (n.is_leaf()) {
    const Leaf& leaf = leaves_[n.left];
    for (uint32_t i = 0; i < n.count; ++i) {
      const Point p{leaf.at[0][i], leaf.at[1][i], leaf.at[2][i]};
      if (inside(p, low, high)) visit(p);
    }
    return;
  }
  // Equal coordinates may lie on either side: a median splits them.
  if (low[n.axis] <= n.split) visit_box(n.left, low, high, visit);
  if (high[n.axis] >= n.split) visit_box(n.right, low, high, visit);
}

bool IncrementalKdTree::any_in_box(const float* low, const float* high) const {
  bool found = false;
  if (root_ != kNone) visit_box(root_, low, high, [&](const Point&) { found = true; });
  return found;
}

// Of the points of one cube the one of the lowest rank stays, whichever came first. False: the new one is not wanted.
bool IncrementalKdTree::thin_out(const Point& point) {
  if (root_ == kNone) return true;
  const auto cube = [this](float x) { return std::floor(static_cast<double>(x) / spacing_); };
  float low[3], high[3];
  for (size_t k = 0; k < 3; ++k) {
    low[k] = static_cast<float>(cube(point[k]) * spacing_);
    high[k] = static_cast<float>((cube(point[k]) + 1.0) * spacing_);
  }
  bool wanted = true, has_old = false;
  Point old{};
  visit_box(root_, low, high, [&](const Point& p) {
    // The box is closed and rounded; the cube is neither.
    for (size_t k = 0; k < 3; ++k)
      if (cube(p[k]) != cube(point[k])) return;
    has_old = true;
    old = p;
    const uint32_t mine = point_rank(point.data()), other = point_rank(p.data());
    if (other < mine || (other == mine && p <= point)) wanted = false;
  });
  if (wanted && has_old) erase_exactly(old);
  return wanted;
}

bool IncrementalKdTree::erase_exactly(const Point& point) {
  const size_t before = size();
  const Cell all{{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}};
  struct Exactly {
    const Point& p;
    bool outside(const Cell& c) const { return !inside(p, c.low, c.high); }
    bool covers(const Cell&) const { return false; }
    bool takes(const Point& q) const { return q == p; }
  };
  root_ = remove(root_, all, Exactly{point});
  return size() < before;
}

size_t IncrementalKdTree::insert(std::span<const float> points) {
  const size_t before = size();
  for (size_t i = 0; i + 2 < points.size(); i += 3) {
    const Point p{points[i], points[i + 1], points[i + 2]};
    if (!std::isfinite(p[0] + p[1] + p[2])) continue;
    if (spacing_ > 0.0 && !thin_out(p)) continue;
    add(p);
  }
  return size() - before;
}

// Removes what the test takes below a node; returns what stands in its place, kNone for nothing.
template <typename Test>
uint32_t IncrementalKdTree::remove(uint32_t node, const Cell& cell, const Test& test) {
  if (node == kNone || test.outside(cell)) return node;
  if (test.covers(cell)) {
    release(node);
    return kNone;
  }
  if (nodes_[node].is_leaf()) {
    Node& n = nodes_[node];
    Leaf& leaf = leaves_[n.left];
    uint32_t kept = 0;
    for (uint32_t i = 0; i < n.count; ++i) {
      const Point p{leaf.at[0][i], leaf.at[1][i], leaf.at[2][i]};
      if (test.takes(p)) continue;
      for (size_t k = 0; k < 3; ++k) leaf.at[k][kept] = p[k];
      ++kept;
    }
    n.count = kept;
    if (kept > 0) return node;
    release(node);
    return kNone;
  }
  Cell below = cell, above = cell;
  const Node n = nodes_[node];
  below.high[n.axis] = n.split;
  above.low[n.axis] = n.split;
  const uint32_t left = remove(n.left, below, test), right = remove(n.right, above, test);
  if (left == kNone || right == kNone) {
    free_nodes_.push_back(node);
    return left == kNone ? right : left;
  }
  nodes_[node].left = left;
  nodes_[node].right = right;
  nodes_[node].count = nodes_[left].count + nodes_[right].count;
  return node;
}

size_t IncrementalKdTree::remove_box(const float* low, const float* high) {
  struct Inside {
    const float *low, *high;
    bool outside(const Cell& c) const {
      for (int k = 0; k < 3; ++k)
        if (c.low[k] > high[k] || c.high[k] < low[k]) return true;
      return false;
    }
    bool covers(const Cell& c) const {
      for (int k = 0; k < 3; ++k)
        if (c.low[k] < low[k] || c.high[k] > high[k]) return false;
      return true;
    }
    bool takes(const Point& p) const { return inside(p, low, high); }
  };
  const size_t before = size();
  root_ = remove(root_, {{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}}, Inside{low, high});
  return before - size();
}

size_t IncrementalKdTree::remove_beyond(const float* centre, float radius) {
  struct Beyond {
    const float* centre;
    float square;
    bool outside(const Cell& c) const {  // wholly near: its farthest corner is
      float far = 0.0F;
      for (int k = 0; k < 3; ++k) {
        const float d = std::max(std::abs(c.low[k] - centre[k]), std::abs(c.high[k] - centre[k]));
        far += d * d;
      }
      return far <= square;
    }
    bool covers(const Cell& c) const {  // wholly far: its nearest place is
      float near = 0.0F;
      for (int k = 0; k < 3; ++k) {
        const float d = std::max({c.low[k] - centre[k], centre[k] - c.high[k], 0.0F});
        near += d * d;
      }
      return near > square;
    }
    bool takes(const Point& p) const {
      const float x = p[0] - centre[0], y = p[1] - centre[1], z = p[2] - centre[2];
      return x * x + y * y + z * z > square;
    }
  };
  const size_t before = size();
  root_ = remove(root_, {{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}}, Beyond{centre, radius * radius});
  return before - size();
}

struct IncrementalKdTree::Search {
  const IncrementalKdTree& tree;
  const float* query;
  size_t wanted;
  float* found;
  float* places;
  size_t count;
  float worst;

  void offer(float square, const Point& p) {
    if (count == wanted && square == found[count - 1]) {  // ties go by coordinates
      const float* last = places + 3 * (count - 1);
      if (!(p < Point{last[0], last[1], last[2]})) return;
    }
    size_t at = count < wanted ? count++ : wanted - 1;
    for (; at > 0; --at) {
      const float* prior = places + 3 * (at - 1);
      if (found[at - 1] < square || (found[at - 1] == square && Point{prior[0], prior[1], prior[2]} <= p)) break;
      found[at] = found[at - 1];
      std::copy_n(prior, 3, places + 3 * at);
    }
    found[at] = square;
    std::copy_n(p.data(), 3, places + 3 * at);
    if (count == wanted) worst = found[wanted - 1];
  }

  void visit(uint32_t node, float* aside, float square) {
    const Node& n = tree.nodes_[node];
    if (n.is_leaf()) {
      const Leaf& leaf = tree.leaves_[n.left];
      float d[kLeaf];
      for (size_t i = 0; i < kLeaf; ++i) {
        const float x = leaf.at[0][i] - query[0], y = leaf.at[1][i] - query[1], z = leaf.at[2][i] - query[2];
        d[i] = x * x + y * y + z * z;
      }
      for (size_t i = 0; i < n.count; ++i)
        if (d[i] <= worst) offer(d[i], {leaf.at[0][i], leaf.at[1][i], leaf.at[2][i]});
      return;
    }
    const float offset = query[n.axis] - n.split;
    visit(offset < 0.0F ? n.left : n.right, aside, square);
    const float old = aside[n.axis], beyond = square - old * old + offset * offset;
    if (beyond * 0.99999F > worst) return;  // the margin keeps rounding from cutting off an equal point
    aside[n.axis] = offset;
    visit(offset < 0.0F ? n.right : n.left, aside, beyond);
    aside[n.axis] = old;
  }
};

size_t IncrementalKdTree::nearest(const float* query, size_t count, float max_square, float* found, float* places) const {
  if (root_ == kNone || count == 0) return 0;
  Search search{*this, query, count, found, places, 0, max_square};
  float aside[3] = {0.0F, 0.0F, 0.0F};
  search.visit(root_, aside, 0.0F);
  return search.count;
}

size_t IncrementalKdTree::depth_of(uint32_t node) const {
  const Node& n = nodes_[node];
  return n.is_leaf() ? 1 : 1 + std::max(depth_of(n.left), depth_of(n.right));
}

size_t IncrementalKdTree::bytes() const {
  return nodes_.capacity() * sizeof(Node) + leaves_.capacity() * sizeof(Leaf) +
         (free_nodes_.capacity() + free_leaves_.capacity()) * sizeof(uint32_t);
}

std::vector<float> IncrementalKdTree::points() const {
  std::vector<Point> all;
  all.reserve(size());
  if (root_ != kNone) collect(root_, &all);
  std::vector<float> out;
  out.reserve(3 * all.size());
  for (const Point& p : all) out.insert(out.end(), p.begin(), p.end());
  return out;
}

}  // namespace heliograph
