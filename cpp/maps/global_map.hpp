// SPDX-License-Identifier: MIT
// The map that a run writes: one averaged point a cube.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "util/flat_index.hpp"

namespace heliograph {

class GlobalMap {
 public:
  explicit GlobalMap(double voxel);

  // Adds points of the body frame at pose T_map_body (row-major 4x4); `intensity` is empty or one value a point.
  void insert(std::span<const float> points_body, std::span<const float> intensity, const double* T_map_body);

  size_t size() const { return cells_.size(); }
  size_t bytes() const { return index_.bytes() + cells_.capacity() * sizeof(Cell); }
  std::vector<float> points() const;     // (M, 3) mean of each cube, in the order in which cubes were first seen
  std::vector<float> intensity() const;  // (M,)
  std::vector<float> counts() const;     // (M,) points averaged

 private:
  struct Cell {
    uint64_t key;
    float sum[3];  // relative to the cube's centre
    float intensity;
    float count;
    float unused;
  };
  double voxel_;
  FlatIndex index_;
  std::vector<Cell> cells_;
};

}  // namespace heliograph
