// SPDX-License-Identifier: MIT
// What a simulated world is made of: a shape in space, and how it reflects.
#pragma once
#include <cstdint>
#include <limits>

#include <Eigen/Core>

namespace heliograph::sim {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

enum class Shape : std::int32_t { rectangle = 0, box = 1, cylinder = 2 };

// One surface patch. `R_world_local` has the local axes as columns; the rectangle lies in local z = 0, the
// cylinder's axis is local z with radius half.x(). All lengths in metres.
struct Primitive {
  Eigen::Matrix3d R_world_local;
  Eigen::Vector3d center;
  Eigen::Vector3d half;
  Shape shape;
  double reflectivity;  // of the brighter texture cells, 0 to 1
  double contrast;      // the darker cells reflect (1 - contrast) of that
  double period;        // edge of a texture cell [m]
};

// A hit in local coordinates: distance along the ray, infinite without one, and a unit normal there (either sign).
struct LocalHit {
  double range = kInfinity;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
};

// The nearest hit not before `min_range`; origin and direction are in the primitive's own axes.
LocalHit hit_primitive(const Primitive& p, const Eigen::Vector3d& o, const Eigen::Vector3d& d, double min_range);

// Reflectivity at a point in the primitive's own axes.
double texture(const Primitive& p, const Eigen::Vector3d& local);

// An axis-aligned box, empty until something is included.
struct Bounds {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(kInfinity);
  Eigen::Vector3d high = Eigen::Vector3d::Constant(-kInfinity);

  void include(const Bounds& other) {
    low = low.cwiseMin(other.low);
    high = high.cwiseMax(other.high);
  }
  double area() const {
    const Eigen::Vector3d e = high - low;
    return e.x() * e.y() + e.y() * e.z() + e.z() * e.x();
  }
};

// The axis-aligned box around an oriented primitive.
Bounds bounds_of(const Primitive& p);

}  // namespace heliograph::sim
