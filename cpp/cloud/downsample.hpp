// SPDX-License-Identifier: MIT
// Thinning of a cloud.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

// Index of one point in each cube of edge `leaf`, drawn by point_rank, in the order of the cubes: neither depends on the
// order of the points. Points that are not finite are left out.
std::vector<int32_t> voxel_downsample(std::span<const float> points, float leaf);

// Indices of the finite points whose distance to the origin lies in [min_range, max_range].
std::vector<int32_t> range_gate(std::span<const float> points, float min_range, float max_range);

}  // namespace heliograph
