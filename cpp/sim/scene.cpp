// SPDX-License-Identifier: MIT
#include "sim/scene.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>
#include <utility>

namespace heliograph::sim {

namespace {

using Eigen::Vector3d;

// A level leaves at most three nodes on the stack. Below kDeepest the tree is halved whatever the areas, so that no
// scene (not even of equal boxes) has more than kDeepest + 31 levels.
constexpr std::size_t kStackDepth = 256;
constexpr std::int32_t kDeepest = 48;

// A node of the binary tree: a primitive, or two children at `child` and `child + 1`.
struct Split {
  Bounds bounds;
  std::int32_t primitive = -1;
  std::int32_t child = 0;
};

// Where to cut items [begin, end) in two: the surface-area heuristic over every cut of every axis. The scenes are
// small, so that the exact sweep costs milliseconds. Leaves the items sorted along the axis of the cut.
std::int32_t cut(const std::vector<Bounds>& bounds, std::span<std::int32_t> items) {
  const auto sort_along = [&](int axis) {
    std::sort(items.begin(), items.end(), [&](std::int32_t a, std::int32_t b) {
      const double ca = bounds[a].low[axis] + bounds[a].high[axis], cb = bounds[b].low[axis] + bounds[b].high[axis];
      return ca != cb ? ca < cb : a < b;
    });
  };
  const std::size_t n = items.size();
  double best_cost = kInfinity;
  int best_axis = 0;
  std::size_t best_left = n / 2;
  std::vector<double> right_area(n, 0.0);
  for (int axis = 0; axis < 3; ++axis) {
    sort_along(axis);
    Bounds right, left;
    for (std::size_t i = n - 1; i > 0; --i) {
      right.include(bounds[items[i]]);
      right_area[i] = right.area();
    }
    for (std::size_t i = 1; i < n; ++i) {
      left.include(bounds[items[i - 1]]);
      const double cost = left.area() * static_cast<double>(i) + right_area[i] * static_cast<double>(n - i);
      if (cost < best_cost) best_cost = cost, best_axis = axis, best_left = i;
    }
  }
  sort_along(best_axis);
  return static_cast<std::int32_t>(best_left);
}

std::vector<Split> build_tree(const std::vector<Bounds>& bounds) {
  std::vector<std::int32_t> order(bounds.size());
  std::iota(order.begin(), order.end(), 0);
  struct Task {
    std::int32_t node, begin, end, level;
  };
  std::vector<Split> tree(1);
  std::vector<Task> tasks{{0, 0, static_cast<std::int32_t>(bounds.size()), 0}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    for (std::int32_t i = task.begin; i < task.end; ++i) tree[task.node].bounds.include(bounds[order[i]]);
    if (task.end - task.begin == 1) {
      tree[task.node].primitive = order[task.begin];
      continue;
    }
    const std::int32_t n = task.end - task.begin;
    const std::int32_t middle =
        task.begin + (task.level < kDeepest ? cut(bounds, std::span(order).subspan(task.begin, n)) : n / 2);
    const auto child = static_cast<std::int32_t>(tree.size());
    tree[task.node].child = child;
    tree.resize(tree.size() + 2);
    tasks.push_back({child, task.begin, middle, task.level + 1});
    tasks.push_back({child + 1, middle, task.end, task.level + 1});
  }
  return tree;
}

// Up to four nodes that together replace `node`: the largest inner one is opened as long as there is room.
std::vector<std::int32_t> open_up(const std::vector<Split>& tree, std::int32_t node) {
  std::vector<std::int32_t> parts{node};
  while (parts.size() < 4) {
    const auto largest = std::max_element(parts.begin(), parts.end(), [&](std::int32_t a, std::int32_t b) {
      const auto size = [&](std::int32_t k) { return tree[k].primitive >= 0 ? -1.0 : tree[k].bounds.area(); };
      return size(a) < size(b);
    });
    if (tree[*largest].primitive >= 0) break;
    const std::int32_t child = tree[*largest].child;
    *largest = child;
    parts.push_back(child + 1);
  }
  return parts;
}

struct Pending {
  std::int32_t child;
  float enter;
};

// A ray in the form that the box test wants.
class Ray {
 public:
  Ray(const Vector3d& origin, const Vector3d& direction) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto d = static_cast<float>(direction[axis]);
      origin_[axis] = static_cast<float>(origin[axis]);
      // A zero component would make 0 * infinity; a tiny one gives the same boxes.
      inverse_[axis] = 1.0F / (std::abs(d) > 1e-30F ? d : 1e-30F);
      near_[axis] = inverse_[axis] < 0.0F ? 1 : 0;
    }
  }

  // Where the ray enters and leaves four boxes, both within [0, limit]; a box is missed if it leaves before it enters.
  std::pair<Eigen::Array4f, Eigen::Array4f> through(
      const std::array<std::array<Eigen::Array4f, 3>, 2>& bound, float limit) const {
    Eigen::Array4f enter = Eigen::Array4f::Zero(), leave = Eigen::Array4f::Constant(limit);
    for (int axis = 0; axis < 3; ++axis) {
      enter = enter.max((bound[near_[axis]][axis] - origin_[axis]) * inverse_[axis]);
      leave = leave.min((bound[1 - near_[axis]][axis] - origin_[axis]) * inverse_[axis]);
    }
    return {enter, leave};
  }

 private:
  std::array<float, 3> origin_;
  std::array<float, 3> inverse_;
  std::array<int, 3> near_;
};

}  // namespace

Scene::Scene(std::vector<Primitive> primitives) : primitives_(std::move(primitives)) {
  if (primitives_.empty()) return;
  std::vector<Bounds> bounds(primitives_.size());
  std::transform(primitives_.begin(), primitives_.end(), bounds.begin(), bounds_of);
  const std::vector<Split> tree = build_tree(bounds);
  const float slack = 1e-5F * static_cast<float>(std::max(tree.front().bounds.low.cwiseAbs().maxCoeff(),
                                                          tree.front().bounds.high.cwiseAbs().maxCoeff()));
  // Each wide node takes over up to four descendants of a binary one; `origin[k]` is the binary node of wide node k.
  std::vector<std::int32_t> origin{0};
  for (std::size_t k = 0; k < origin.size(); ++k) {
    Node node;
    node.child.fill(0);
    for (int axis = 0; axis < 3; ++axis) {
      node.bound[0][axis].setConstant(std::numeric_limits<float>::infinity());
      node.bound[1][axis].setConstant(-std::numeric_limits<float>::infinity());
    }
    int lane = 0;
    for (const std::int32_t part : open_up(tree, origin[k])) {
      for (int axis = 0; axis < 3; ++axis) {
        node.bound[0][axis][lane] = static_cast<float>(tree[part].bounds.low[axis]) - slack;
        node.bound[1][axis][lane] = static_cast<float>(tree[part].bounds.high[axis]) + slack;
      }
      node.child[lane++] = tree[part].primitive >= 0 ? ~tree[part].primitive : static_cast<std::int32_t>(origin.size());
      if (tree[part].primitive < 0) origin.push_back(part);
    }
    nodes_.push_back(node);
  }
}

Hit Scene::nearest(const Vector3d& origin, const Vector3d& direction, double min_range, double max_range,
                   std::int32_t hint) const {
  if (primitives_.empty()) return {};
  std::int32_t best = -1;
  LocalHit best_hit;
  best_hit.range = max_range;
  Vector3d best_local = Vector3d::Zero(), best_direction = Vector3d::Zero();
  const auto test = [&](std::int32_t id) {
    const Primitive& p = primitives_[id];
    const Vector3d o = p.R_world_local.transpose() * (origin - p.center);
    const Vector3d d = p.R_world_local.transpose() * direction;
    const LocalHit hit = hit_primitive(p, o, d, min_range);
    const bool nearer = hit.range < best_hit.range || (hit.range == best_hit.range && (best < 0 || id < best));
    if (!nearer) return;
    best = id, best_hit = hit, best_local = o + hit.range * d, best_direction = d;
  };
  if (hint >= 0 && hint < static_cast<std::int32_t>(primitives_.size())) test(hint);

  const Ray ray(origin, direction);
  std::array<Pending, kStackDepth> stack;
  std::size_t depth = 0;
  stack[depth++] = {0, 0.0F};
  while (depth > 0) {
    const Pending pending = stack[--depth];
    if (pending.enter > best_hit.range) continue;
    if (pending.child < 0) {
      if (~pending.child != hint) test(~pending.child);
      continue;
    }
    const Node& node = nodes_[pending.child];
    const auto [enter, leave] = ray.through(node.bound, static_cast<float>(best_hit.range));
    const std::size_t base = depth;
    for (int lane = 0; lane < 4; ++lane) {
      if (enter[lane] > leave[lane]) continue;
      std::size_t at = depth++;  // kept in order, so that the nearest child is visited first
      for (; at > base && stack[at - 1].enter < enter[lane]; --at) stack[at] = stack[at - 1];
      stack[at] = {node.child[lane], enter[lane]};
    }
  }
  if (best < 0) return {};
  const double cosine = std::abs(best_hit.normal.dot(best_direction)) / direction.norm();
  return {best_hit.range, static_cast<float>(texture(primitives_[best], best_local) * cosine), best};
}

}  // namespace heliograph::sim
