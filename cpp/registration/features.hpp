// SPDX-License-Identifier: MIT
// Features of surface elements, their matches, and the matches that agree with each other.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "registration/surface_elements.hpp"

namespace heliograph {

constexpr size_t kFeature = 33;

// Fast point feature histograms (R. Rusu, N. Blodow, M. Beetz, ICRA 2009): of each element of a level, eleven bins of each
// of three angles between its normal and those of its neighbours within `radius`. Normals are turned to the origin.
std::vector<float> point_features(SurfaceCloud& cloud, size_t level, double radius, int threads);

// For each row of `a` (n x 33) the `count` nearest rows of `b`, nearest first, -1 where there are fewer.
std::vector<int32_t> nearest_features(std::span<const float> a, std::span<const float> b, size_t count, int threads);

// Pairs of places that may be the same: (p, q) with the unit normals there.
struct PlacePair {
  std::array<float, 3> p, q, normal_p, normal_q;
};

// Sets of pairs that one rigid motion could make, all of them mutually consistent: distances agree within `tolerance`
// and the normals' angles within `max_angle`. Grown from up to `seeds` pairs with the most common consistent partners
// (second-order compatibility: Z. Chen et al., CVPR 2022), each set at least three strong, the largest first.
std::vector<std::vector<uint32_t>> consistent_sets(std::span<const PlacePair> pairs, double tolerance, double max_angle,
                                                   size_t seeds, int threads);

}  // namespace heliograph
