// SPDX-License-Identifier: MIT
#include "sim/primitive.hpp"

#include <cmath>

namespace heliograph::sim {

namespace {

using Eigen::Vector3d;

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

}  // namespace

LocalHit hit_primitive(const Primitive& p, const Vector3d& o, const Vector3d& d, double min_range) {
  switch (p.shape) {
    case Shape::rectangle: return hit_rectangle(o, d, p.half, min_range);
    case Shape::box: return hit_box(o, d, p.half, min_range);
    case Shape::cylinder: return hit_cylinder(o, d, p.half, min_range);
  }
  return {};
}

// A three-dimensional checkerboard fixed to the primitive. The quarter-cell shift keeps cell borders off its faces.
double texture(const Primitive& p, const Vector3d& local) {
  const Vector3d cell = ((local / p.period).array() + 0.25).floor();
  const auto parity = static_cast<std::int64_t>(cell.x() + cell.y() + cell.z()) & 1;
  return p.reflectivity * (parity != 0 ? 1.0 - p.contrast : 1.0);
}

Bounds bounds_of(const Primitive& p) {
  Vector3d half = p.half;
  if (p.shape == Shape::rectangle) half.z() = 0.0;
  if (p.shape == Shape::cylinder) half.y() = half.x();
  const Vector3d reach = p.R_world_local.cwiseAbs() * half;
  return {p.center - reach, p.center + reach};
}

}  // namespace heliograph::sim
