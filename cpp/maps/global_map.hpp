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

  // Adds points of the body frame at pose T_map_body (row-major 4x4); `intensity` is empty or one value a point. Throws
  // std::invalid_argument, as `merge` does, where a point lies farther from the first one than keys can tell.
  void insert(std::span<const float> points_body, std::span<const float> intensity, const double* T_map_body);

  // Adds cells of another map with the same cubes: their indices (M, 3), sums of offsets from the cubes' centres (M, 3),
  // sums of intensity (M,) and counts (M,), all of one visit. Where T_map_odom is given, the cells are moved by it first:
  // each mean goes, with its weight, into the cube in which it comes to lie.
  struct Cells {
    std::span<const int32_t> cubes;
    std::span<const float> sums, intensity, counts;
  };
  void merge(const Cells& cells, const double* T_map_odom, uint32_t visit);

  // Forgets all cells and keeps the memory for the next ones.
  void clear();

  // Keeps the cells of which `wanted` is not 0.
  void keep(std::span<const uint8_t> wanted);

  size_t size() const { return cells_.size(); }
  size_t bytes() const { return index_.bytes() + cells_.capacity() * sizeof(MapCell); }
  std::vector<double> points() const;         // (M, 3) mean of each cube, in the order in which cubes were first seen
  std::vector<float> intensity() const;       // (M,)
  std::vector<float> counts() const;          // (M,) points averaged
  std::vector<uint32_t> visits() const;       // (M,) how many visits saw it, at most kMaxVisits
  std::vector<uint32_t> first() const;        // (M,) number of the first of them
  std::vector<int32_t> cubes() const;         // (M, 3) index of each cube along the axes
  std::vector<float> sums() const;            // (M, 3) sum of the points' offsets from the cube's centre
  std::vector<float> intensity_sums() const;  // (M,)

  // Normals (K, 3) of the planes that the cells make with those about them; zero where they make none.
  std::vector<float> normals(std::span<const uint32_t> cells);
  // Of the 26 cubes about each cell, how many hold one that is marked, and how many hold any, (K, 2).
  std::vector<uint32_t> marked_around(std::span<const uint32_t> cells, std::span<const uint8_t> marked);

  // The means without the traces of the grid, see surfaces.hpp. Gives the index's memory back, which the next insertion
  // takes again: this is done once, when a map is complete and at its largest.
  SurfacePoints surfaces(double thickness, int threads);

 private:
  Cube moved(const int32_t* cube, const float* sum, float count, const double* T, std::array<float, 3>& moved_sum) const;
  uint64_t key_of(const Cube& cube);
  Cube cube_of(const MapCell& cell) const;
  uint32_t place(uint64_t key, uint32_t visit);
  template <typename See>
  void about(const MapCell& cell, See&& see) const;

  void reindex();

  double voxel_;
  FlatIndex index_;
  std::vector<MapCell> cells_;
  // Keys count from here, so that none folds however far from the frame's origin the map lies.
  Cube origin_{0, 0, 0};
  bool placed_ = false;
};

}  // namespace heliograph
