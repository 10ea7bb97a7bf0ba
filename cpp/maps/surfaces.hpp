// SPDX-License-Identifier: MIT
// Means of cubes brought onto the surfaces that they were measured on, so that the grid of the cubes does not show.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "util/voxel_key.hpp"

namespace heliograph {

constexpr uint32_t kMaxVisits = 255;  // that a cell counts

// What one cube has added up.
struct MapCell {
  uint64_t key;  // of its way from the map's first cube
  float sum[3];  // of offsets from the cube's centre
  float intensity;
  float count;
  uint32_t visit;  // number of the first visit in the upper 24 bits, how many there were in the lower 8

  uint32_t first() const { return visit >> 8; }
  uint32_t visits() const { return visit & kMaxVisits; }
};

struct SurfacePoints {
  std::vector<double> points;    // (N, 3)
  std::vector<float> intensity;  // (N,)
  std::vector<float> counts;     // (N,) points averaged
  std::vector<uint32_t> first;   // (N,) number of the first visit
};

// Plane-wise averages of the cells' means. A cell whose surroundings (the 27 cubes about it) are a plane, or that lies
// on the plane of a neighbour, is moved along the normal onto it; cells that then lie at one place are one point. All
// other cells keep their mean. A surface's means scatter about its plane by no more than `thickness` (RMS).
// Points come in the order of the first cell of each; the bits do not depend on `threads`. `origin` is the cube from which
// the cells' keys count.
SurfacePoints surface_points(std::span<const MapCell> cells, const Cube& origin, double voxel, double thickness,
                             int threads);

}  // namespace heliograph
