// SPDX-License-Identifier: MIT
// First poses of a pose graph from its relative poses alone.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

struct SpanningStart {
  std::vector<double> pose;     // (n, k, k) homogeneous matrices T_root_i
  std::vector<int32_t> root;    // (n) the pose at the origin of i's component: its lowest number
  std::vector<int32_t> parent;  // (n) the pose that i was placed from, itself at a root
};

// `dimension` 2 or 3; edge e says T_i_j = relative[e], a homogeneous matrix of k = dimension + 1 rows. In each component the
// lowest pose is at the origin, the poses after it follow along edges between neighbouring numbers as far as those reach
// (either direction, the first of parallel ones), and the rest is placed breadth first, neighbours in the order of the edges.
SpanningStart spanning_start(int dimension, size_t n, std::span<const int32_t> i, std::span<const int32_t> j,
                             std::span<const double> relative);

}  // namespace heliograph
