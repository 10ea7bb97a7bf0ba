// SPDX-License-Identifier: MIT
// A local map made of an incremental k-d tree: scans go in, planes through nearest neighbours come out.
#pragma once
#include <span>

#include "maps/incremental_kd_tree.hpp"
#include "maps/seen_cubes.hpp"

namespace heliograph {

// Adds points of the body frame at pose T_odom_body (row-major 4x4), and the cubes that they touch to those seen.
// Returns which share of these held no point before.
double insert_scan(IncrementalKdTree& tree, std::span<const float> points_body, const double* T_odom_body, SeenCubes& seen);

// Forgets the points in cubes that none of the last `insertions` scans touched.
void forget_unseen(IncrementalKdTree& tree, SeenCubes& seen, uint32_t insertions);

struct NeighbourPlaneSettings {
  size_t neighbours;
  double reach;          // to the farthest of them [m]
  double max_thickness;  // largest standard deviation across the plane [m]
  double min_spread;     // smallest along it [m]
  double gate;           // largest distance of the query from the plane [m]
};

struct NeighbourPlanes {
  float* normal;    // 3 a query
  double* point;    // 3 a query
  float* variance;
  uint8_t* source;  // 255 a plane, 0 none
};

void neighbour_planes(const IncrementalKdTree& tree, std::span<const double> queries,
                      const NeighbourPlaneSettings& settings, const NeighbourPlanes& out, int threads);

}  // namespace heliograph
