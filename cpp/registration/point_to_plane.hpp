// SPDX-License-Identifier: MIT
// The registration's one hot loop: each point finds its plane and adds its residual to the normal equations.
#pragma once
#include <cstdint>
#include <span>

#include "maps/voxel_map.hpp"

namespace heliograph {

constexpr int kMaxColumns = 18;  // pose, then motion, then mounting, as far as asked for, six each

// Six columns are the pose's: rotation and position. With the motion, velocity and gyroscope bias follow; with the
// mounting, its rotation and lever arm come last.
struct MatchBlocks {
  bool motion;
  bool mounting;

  int columns() const { return 6 + (motion ? 6 : 0) + (mounting ? 6 : 0); }
};

struct MatchSettings {
  double gate;            // largest residual of a match [m]
  double kernel;          // scale of the Geman-McClure kernel [m]; 0: least squares
  double sigma;           // of one range measurement across its plane [m]
  int fallback_stride;    // of the points without a plane, each such one asks for its neighbours; 0: none does
  double fallback_range;  // farthest neighbour [m]
  MatchBlocks blocks;
};

// Sum over matches of J^T w J / s^2 and J^T w r / s^2.
struct NormalEquations {
  double information[kMaxColumns * kMaxColumns] = {};  // row-major with `columns` columns in use
  double gradient[kMaxColumns] = {};
  // What noise of the planes' normals alone adds to the information of pose and motion in expectation, and the sum of the
  // squares of what each match adds to it, over the tilts.
  double feigned[kMaxColumns * kMaxColumns] = {};
  double feigned_square = 0.0;
  double weight = 0.0;       // sum of w / s^2
  double robust_weight = 0.0;  // sum of w
  double square = 0.0;       // sum of w r^2
  double cost = 0.0;         // sum of rho(r) / s^2
  int64_t matches = 0;
  int64_t fallback_matches = 0;
};

// A de-skewed scan at a pose; matrices are row-major 4x4.
struct MatchScan {
  std::span<const float> points_body;  // (N, 3)
  std::span<const float> before_end;   // (N,): each point's time before the sweep's end [s]; of the motion
  const double* T_odom_body;
  const double* T_body_lidar;          // of the mounting
  const double* T_odom_body_first;     // where the map was begun; of the mounting
};

NormalEquations match_planes(const VoxelMap& map, const MatchScan& scan, const MatchSettings& settings, int threads);

// The textbook's comparison: the nearest stored point instead of a plane.
NormalEquations match_points(const VoxelMap& map, const MatchScan& scan, const MatchSettings& settings, int threads);

// The plane of each point of the odom frame, if any: normal (N, 3), point on it (N, 3), variance across it at the query
// (N,), that of its normal about either axis across it (N,), that of its points about it (N,) and the mean number of the
// insertions that brought them (N,), negative where nothing tells, and where it came from (N,): 0 none, 1 + level, or 255 the neighbours.
struct PlaneQuery {
  float* normal;
  double* point;
  float* variance;
  float* tilt;
  float* scatter;
  float* since;
  uint8_t* source;
};
void query_planes(const VoxelMap& map, std::span<const double> points_odom, const MatchSettings& settings, PlaneQuery out);

}  // namespace heliograph
