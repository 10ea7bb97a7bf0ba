// SPDX-License-Identifier: MIT
// Normal equations of point-to-edge and point-to-plane distances to lines and planes found before.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "maps/feature_map.hpp"
#include "registration/point_to_plane.hpp"

namespace heliograph {

struct FeatureScan {
  std::span<const float> points_body;  // (N, 3)
  const double* T_odom_body;           // row-major 4x4
};

// The line or plane of each point, by the map.
std::vector<FeatureMatch> match_features(const FeatureMap& map, const FeatureScan& scan, double sigma, int threads);

// Sums over the pose's six columns; matches whose distance exceeds `gate` are left out. An edge is two rows that share one
// weight. `shares` says how much of a change of the pose moves each point along; where it is empty, all of it does.
NormalEquations sum_features(FeatureKind kind, std::span<const FeatureMatch> matches, const FeatureScan& scan,
                             std::span<const float> shares, double gate, double kernel, double sigma, int threads);

}  // namespace heliograph
