// SPDX-License-Identifier: MIT
// The map that a run writes: one averaged point a cube.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "maps/surfaces.hpp"
#include "util/flat_index.hpp"

namespace heliograph {

class GlobalMap {
 public:
  explicit GlobalMap(double voxel);

  // Adds points of the body frame at pose T_map_body (row-major 4x4); `intensity` is empty or one value a point.
  void insert(std::span<const float> points_body, std::span<const float> intensity, const double* T_map_body);

  // Adds cells of another map with the same cubes: their indices (M, 3), sums of offsets from the cubes' centres (M, 3),
  // sums of intensity (M,) and counts (M,). Where T_map_odom is given, the cells are moved by it first: each mean goes,
  // with its weight, into the cube in which it comes to lie.
  struct Cells {
    std::span<const int32_t> cubes;
    std::span<const float> sums, intensity, counts;
  };
  void merge(const Cells& cells, const double* T_map_odom);

  // Forgets all cells and keeps the memory for the next ones.
  void clear();

  size_t size() const { return cells_.size(); }
  size_t bytes() const { return index_.bytes() + cells_.capacity() * sizeof(MapCell); }
  std::vector<float> points() const;     // (M, 3) mean of each cube, in the order in which cubes were first seen
  std::vector<float> intensity() const;  // (M,)
  std::vector<float> counts() const;     // (M,) points averaged
  std::vector<int32_t> cubes() const;    // (M, 3) index of each cube along the axes
  std::vector<float> sums() const;       // (M, 3) sum of the points' offsets from the cube's centre
  std::vector<float> intensity_sums() const;  // (M,)

  // The means without the traces of the grid, see surfaces.hpp. Gives the index's memory back, which the next insertion
  // takes again: this is done once, when a map is complete and at its largest.
  SurfacePoints surfaces(double thickness, int threads);

 private:
  Cube moved(const int32_t* cube, const float* sum, float count, const double* T, std::array<float, 3>& moved_sum) const;

  void reindex();

  double voxel_;
  FlatIndex index_;
  std::vector<MapCell> cells_;
};

}  // namespace heliograph
