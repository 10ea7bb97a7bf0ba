// SPDX-License-Identifier: MIT
// Means of cubes brought onto the surfaces that they were measured on, so that the grid of the cubes does not show.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

// What one cube has added up.
struct MapCell {
  uint64_t key;
  float sum[3];  // of offsets from the cube's centre
  float intensity;
  float count;
  float unused;
};

struct SurfacePoints {
  std::vector<float> points;     // (N, 3)
  std::vector<float> intensity;  // (N,)
  std::vector<float> counts;     // (N,) points averaged
};

// Plane-wise averages of the cells' means. A cell whose surroundings (the 27 cubes about it) are a plane, or that lies
// on the plane of a neighbour, is moved along the normal onto it; cells that then lie at one place are one point. All
// other cells keep their mean. A surface's means scatter about its plane by no more than `thickness` (RMS).
// Points come in the order of the first cell of each; the bits do not depend on `threads`.
SurfacePoints surface_points(std::span<const MapCell> cells, double voxel, double thickness, int threads);

}  // namespace heliograph
