// SPDX-License-Identifier: MIT
// What registration makes of a cloud: one element a cube, or one a point, with the surface that its surroundings make.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "maps/kd_tree.hpp"
#include "util/flat_index.hpp"

namespace heliograph {

enum class Shape : uint8_t { scatter = 0, plane = 1, line = 2 };

// All in the cloud's own frame.
struct SurfaceElement {
  float mean[3];    // of the element's own points [m]
  float centre[3];  // of the points that made its surface
  float axes[9];    // rows: across the surface, along it, most along it (unit eigenvectors, values ascending)
  float values[3];  // variances along the axes [m^2]
  float count;      // of its own points
  float support;    // of the points that made its surface
  Shape shape;
};

inline float square_distance(const float* a, const float* b) {
  const float d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  return d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
}

struct ElementSettings {
  double voxel;          // edge of the finest cubes [m]; 0: one element a point
  int levels;            // of cubes, each twice as wide as the one before
  double max_thickness;  // largest standard deviation across a plane or line [m]
  int min_support;       // points that a surface needs; of elements a point: the neighbours that make it
};

struct ElementLevel {
  double edge;  // of its cubes [m]; 0: points
  std::vector<SurfaceElement> elements;
  FlatIndex index;  // cube -> element; empty for points
  std::unique_ptr<KdTree> tree;
};

// A cloud prepared for registration: its elements level by level, finest first. The surface of an element is that of the
// smallest cube around it, from its own upwards, whose points make a plane; a sparse ring finds its floor that way.
class SurfaceCloud {
 public:
  SurfaceCloud(std::span<const float> points, const ElementSettings& settings, int threads);
  SurfaceCloud(const SurfaceCloud&) = delete;
  SurfaceCloud& operator=(const SurfaceCloud&) = delete;

  size_t levels() const { return levels_.size(); }
  const ElementLevel& level(size_t at) const { return levels_[at]; }
  // Makes the search tree of a level where it is not there yet; not to be called from two threads at once.
  const KdTree& tree(size_t at);
  // For elements that are points: which point of the cloud each is.
  const std::vector<uint32_t>& source() const { return source_; }
  size_t finite() const { return finite_; }
  // Largest side of the box around a level's elements, and the standard deviations of their means, ascending [m].
  double extent(size_t level) const;
  void spread(size_t level, double* sigmas) const;

 private:
  void make_cubes(std::span<const float> points, const ElementSettings& settings);
  void make_points(std::span<const float> points, const ElementSettings& settings, int threads);

  std::vector<ElementLevel> levels_;
  std::vector<uint32_t> source_;
  size_t finite_ = 0;
};

}  // namespace heliograph
