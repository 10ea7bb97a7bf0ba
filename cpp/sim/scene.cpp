// SPDX-License-Identifier: MIT
#include "sim/scene.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace heliograph::sim {

namespace {

using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::int32_t kLeafSize = 2;
constexpr std::size_t kStackDepth = 64;

// A hit in local coordinates: distance along the ray and the outward normal there.
struct LocalHit {
  double range = kInfinity;
  Vector3d normal = Vector3d::UnitZ();
};

LocalHit hit_rectangle(const Vector3d& o, const Vector3d& d, const Vector3d& half, double min_range) {
  LocalHit hit;
  if (d.z() == 0.0) return hit;
  const double t = -o.z() / d.z();
  if (t < min_range) return hit;
  if (std::abs(o.x() + t * d.x()) > half.x() || std::abs(o.y() + t * d.y()) > half.y()) return hit;
  hit.range = t;
  return hit;
}

// The slab method; a ray that starts inside (or nearer than min_range) sees the far face.
LocalHit hit_box(const Vector3d& o, const Vector3d& d, const Vector3d& half, double min_range) {
  double enter = -kInfinity, leave = kInfinity;
  int enter_axis = 0, leave_axis = 0;
  for (int axis = 0; axis < 3; ++axis) {
    if (d[axis] == 0.0) {
      if (std::abs(o[axis]) > half[axis]) return {};
      continue;
    }
    const double inverse = 1.0 / d[axis];
    const double near = (-std::copysign(half[axis], inverse) - o[axis]) * inverse;
    const double far = (std::copysign(half[axis], inverse) - o[axis]) * inverse;
    if (near > enter) enter = near, enter_axis = axis;
    if (far < leave) leave = far, leave_axis = axis;
  }
  LocalHit hit;
  if (enter > leave) return hit;
  if (enter >= min_range) {
    hit.range = enter;
    hit.normal = Vector3d::Unit(enter_axis);
  } else if (leave >= min_range) {
    hit.range = leave;
    hit.normal = Vector3d::Unit(leave_axis);
  }
  return hit;
}

LocalHit hit_cylinder(const Vector3d& o, const Vector3d& d, const Vector3d& half, double min_range) {
  LocalHit hit;
  const double radius = half.x();
  const double a = d.x() * d.x() + d.y() * d.y();
  const double b = o.x() * d.x() + o.y() * d.y();
  const double c = o.x() * o.x() + o.y() * o.y() - radius * radius;
  const double discriminant = b * b - a * c;
  if (discriminant < 0.0) return hit;
  if (a > 0.0) {
    const double root = std::sqrt(discriminant);
    for (const double t : {(-b - root) / a, (-b + root) / a}) {
      if (t < min_range || std::abs(o.z() + t * d.z()) > half.z()) continue;
      hit.range = t;
      hit.normal = Vector3d((o.x() + t * d.x()) / radius, (o.y() + t * d.y()) / radius, 0.0);
      break;
    }
  }
  if (d.z() == 0.0) return hit;
  for (const double cap : {-half.z(), half.z()}) {
    const double t = (cap - o.z()) / d.z();
    if (t < min_range || t >= hit.range) continue;
    const double x = o.x() + t * d.x(), y = o.y() + t * d.y();
    if (x * x + y * y > radius * radius) continue;
    hit.range = t;
    hit.normal = Vector3d::UnitZ();
  }
  return hit;
}

LocalHit hit_primitive(const Primitive& p, const Vector3d& o, const Vector3d& d, double min_range) {
  switch (p.shape) {
    case Shape::rectangle: return hit_rectangle(o, d, p.half, min_range);
    case Shape::box: return hit_box(o, d, p.half, min_range);
    case Shape::cylinder: return hit_cylinder(o, d, p.half, min_range);
  }
  return {};
}

// A three-dimensional checkerboard fixed to the primitive. The half-cell shift keeps cell borders off its faces.
double texture(const Primitive& p, const Vector3d& local) {
  const Vector3d cell = ((local / p.period).array() + 0.25).floor();
  const auto parity = static_cast<std::int64_t>(cell.x() + cell.y() + cell.z()) & 1;
  return p.reflectivity * (parity != 0 ? 1.0 - p.contrast : 1.0);
}

// Half-extents of the axis-aligned box around an oriented one.
Vector3d reach(const Primitive& p) {
  Vector3d half = p.half;
  if (p.shape == Shape::rectangle) half.z() = 0.0;
  if (p.shape == Shape::cylinder) half.y() = half.x();
  // A little slack, so that a hit on a face is never lost to rounding in the slab test.
  return (p.R_world_local.cwiseAbs() * half).array() + 1e-9 * (1.0 + p.center.cwiseAbs().maxCoeff());
}

double surface_area(const Vector3d& low, const Vector3d& high) {
  const Vector3d e = high - low;
  return e.x() * e.y() + e.y() * e.z() + e.z() * e.x();
}

// Entry distance of a ray into an axis-aligned box, or infinity when it misses it or enters beyond `limit`.
double enter_box(const Vector3d& low, const Vector3d& high, const Vector3d& origin, const Vector3d& inverse,
                 double limit) {
  double enter = 0.0, leave = limit;
  for (int axis = 0; axis < 3; ++axis) {
    const double a = (low[axis] - origin[axis]) * inverse[axis];
    const double b = (high[axis] - origin[axis]) * inverse[axis];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave ? enter : kInfinity;
}

}  // namespace

Scene::Scene(std::vector<Primitive> primitives) : primitives_(std::move(primitives)), order_(primitives_.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  for (const Primitive& p : primitives_) {
    low_.push_back(p.center - reach(p));
    high_.push_back(p.center + reach(p));
  }
  nodes_.reserve(2 * primitives_.size() + 1);
  nodes_.emplace_back();
  split(0, 0, static_cast<std::int32_t>(primitives_.size()));
}

// Surface-area heuristic over every split of every axis: the scenes are small, so the exact sweep costs milliseconds.
void Scene::split(std::int32_t node, std::int32_t begin, std::int32_t end) {
  const std::int32_t n = end - begin;
  Vector3d low = Vector3d::Constant(kInfinity), high = Vector3d::Constant(-kInfinity);
  for (std::int32_t i = begin; i < end; ++i) {
    low = low.cwiseMin(low_[order_[i]]);
    high = high.cwiseMax(high_[order_[i]]);
  }
  nodes_[node].low = low;
  nodes_[node].high = high;
  nodes_[node].first = begin;
  nodes_[node].count = n;
  if (n <= kLeafSize) return;

  const auto sort_along = [&](int axis) {
    std::sort(order_.begin() + begin, order_.begin() + end, [&](std::int32_t a, std::int32_t b) {
      const double ca = low_[a][axis] + high_[a][axis], cb = low_[b][axis] + high_[b][axis];
      return ca != cb ? ca < cb : a < b;
    });
  };
  double best_cost = kInfinity;
  int best_axis = 0;
  std::int32_t best_left = n / 2;
  std::vector<double> right_area(n + 1, 0.0);
  for (int axis = 0; axis < 3; ++axis) {
    sort_along(axis);
    Vector3d l = Vector3d::Constant(kInfinity), h = Vector3d::Constant(-kInfinity);
    for (std::int32_t i = n - 1; i > 0; --i) {
      l = l.cwiseMin(low_[order_[begin + i]]);
      h = h.cwiseMax(high_[order_[begin + i]]);
      right_area[i] = surface_area(l, h);
    }
    l = Vector3d::Constant(kInfinity), h = Vector3d::Constant(-kInfinity);
    for (std::int32_t i = 1; i < n; ++i) {
      l = l.cwiseMin(low_[order_[begin + i - 1]]);
      h = h.cwiseMax(high_[order_[begin + i - 1]]);
      const double cost = surface_area(l, h) * i + right_area[i] * (n - i);
      if (cost < best_cost) best_cost = cost, best_axis = axis, best_left = i;
    }
  }
  sort_along(best_axis);
  const auto child = static_cast<std::int32_t>(nodes_.size());
  nodes_[node].first = child;
  nodes_[node].count = 0;
  nodes_.emplace_back();
  nodes_.emplace_back();
  split(child, begin, begin + best_left);
  split(child + 1, begin + best_left, end);
}

Hit Scene::nearest(const Vector3d& origin, const Vector3d& direction, double min_range, double max_range,
                   std::int32_t hint) const {
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
  if (primitives_.empty()) return {};
  if (hint >= 0 && hint < static_cast<std::int32_t>(primitives_.size())) test(hint);

  // A zero component would make 0 * infinity in the slab test; a tiny one gives the same boxes.
  Vector3d inverse;
  for (int axis = 0; axis < 3; ++axis) {
    inverse[axis] = 1.0 / (std::abs(direction[axis]) > 1e-300 ? direction[axis] : 1e-300);
  }
  struct Pending {
    std::int32_t node;
    double enter;
  };
  std::array<Pending, kStackDepth> stack;
  std::size_t depth = 0;
  stack[depth++] = {0, 0.0};
  while (depth > 0) {
    const Pending pending = stack[--depth];
    if (pending.enter > best_hit.range) continue;
    const Node& node = nodes_[pending.node];
    if (node.count > 0) {
      for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
        if (order_[i] != hint) test(order_[i]);
      }
      continue;
    }
    const Node &left = nodes_[node.first], &right = nodes_[node.first + 1];
    Pending a{node.first, enter_box(left.low, left.high, origin, inverse, best_hit.range)};
    Pending b{node.first + 1, enter_box(right.low, right.high, origin, inverse, best_hit.range)};
    if (a.enter < b.enter) std::swap(a, b);  // the nearer child is visited first
    if (a.enter < kInfinity) stack[depth++] = a;
    if (b.enter < kInfinity) stack[depth++] = b;
  }
  if (best < 0) return {};
  const double cosine = std::abs(best_hit.normal.dot(best_direction)) / direction.norm();
  return {best_hit.range, static_cast<float>(texture(primitives_[best], best_local) * cosine), best};
}

}  // namespace heliograph::sim
