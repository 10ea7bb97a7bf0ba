// SPDX-License-Identifier: MIT
// Trees and registration under the sanitizers: odd inputs, and answers that are known.
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "maps/incremental_kd_tree.hpp"
#include "maps/neighbour_planes.hpp"
#include "registration/features.hpp"
#include "registration/icp.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

constexpr double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

// Three walls of a corner, on a lattice.
std::vector<float> corner() {
  std::vector<float> points;
  for (int i = 0; i < 40; ++i)
    for (int j = 0; j < 40; ++j) {
      const float a = 0.1F * static_cast<float>(i) - 2.0F, b = 0.1F * static_cast<float>(j) - 2.0F;
      for (const auto& p : {std::array<float, 3>{3.0F, a, b}, {a, 3.0F, b}, {a, b, 3.0F}}) points.insert(points.end(), p.begin(), p.end());
    }
  return points;
}

void check_trees() {
  const std::vector<float> points = corner();
  const KdTree still(points);
  IncrementalKdTree moving(0.0, 0.7);
  CHECK(moving.insert(points) == points.size() / 3);
  const float query[3] = {2.9F, 0.02F, 0.03F};
  float found[4], places[12];
  Neighbour near[4];
  CHECK(still.nearest(query, 4, 1.0F, near) == 4);
  CHECK(moving.nearest(query, 4, 1.0F, found, places) == 4);
  for (int i = 0; i < 4; ++i) CHECK_NEAR(near[i].square, found[i], 1e-6F);
  const float low[3] = {2.5F, -9.0F, -9.0F}, high[3] = {9.0F, 9.0F, 9.0F};
  CHECK(moving.remove_box(low, high) == 1600);
  CHECK(moving.remove_beyond(query, 0.0F) == 3200 && moving.size() == 0);
  CHECK(moving.nearest(query, 4, 1.0F, found, places) == 0);
  const std::vector<float> same(3 * 500, 1.0F), odd{std::numeric_limits<float>::quiet_NaN(), 0, 0};
  CHECK(moving.insert(same) == 500 && moving.insert(odd) == 0 && moving.insert({}) == 0);
  CHECK(KdTree({}).nearest(query, 1.0F).index == kNoNeighbour);
}

void check_planes() {
  IncrementalKdTree tree(0.0, 0.7);
  SeenCubes seen(1.0);
  CHECK_NEAR(insert_scan(tree, corner(), kIdentity, seen), 1.0, 0.0);
  CHECK_NEAR(insert_scan(tree, corner(), kIdentity, seen), 0.0, 0.0);
  const std::vector<double> queries{2.95, 0.0, 0.0, 99.0, 0.0, 0.0, std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0};
  float normal[9], variance[3];
  double point[9];
  uint8_t source[3];
  neighbour_planes(tree, queries, {8, 1.0, 0.05, 0.03, 0.2}, {normal, point, variance, source}, 2);
  CHECK(source[0] == 255 && source[1] == 0 && source[2] == 0);
  CHECK_NEAR(std::abs(normal[0]), 1.0F, 1e-4F);
  insert_scan(tree, {}, kIdentity, seen);
  forget_unseen(tree, seen, 2);
  CHECK(tree.size() > 0 && seen.size() > 0);
  forget_unseen(tree, seen, 1);
  CHECK(tree.size() == 0 && seen.size() == 0);
}

void check_iteration() {
  const std::vector<float> points = corner();
  for (const double voxel : {0.0, 0.5}) {
    SurfaceCloud target(points, {voxel, 3, 0.05, 8}, 2), source(points, {voxel, 3, 0.05, 8}, 1);
    double T[16];
    std::copy_n(kIdentity, 16, T);
    T[3] = 0.02;
    target.tree(0);
    for (const Residual residual : {Residual::point, Residual::plane, Residual::edge, Residual::distribution}) {
      const IcpSettings settings{residual, false, 0.5, 0.2, 0.01, 0.5, true};
      std::vector<uint32_t> hints;
      const IcpSums first = icp_sums(target, 0, source, 0, T, settings, &hints, false, 2);
      const IcpSums again = icp_sums(target, 0, source, 0, T, settings, &hints, true, 1);
      CHECK(first.matches == again.matches);
      if (residual == Residual::plane) {
        CHECK(first.matches > 0);
        CHECK_NEAR(first.gradient[3] / first.information[21], 0.02, 1e-3);
      }
      CHECK(icp_matches(target, 0, source, 0, T, settings, hints, 2).size() == static_cast<size_t>(first.matches));
    }
    const auto features = point_features(target, 0, 1.0, 2);
    CHECK(features.size() == kFeature * target.level(0).elements.size());
    CHECK(nearest_features(features, features, 2, 2).size() == 2 * target.level(0).elements.size());
    CHECK_NEAR(overlap_share(target, 0, source, 0, kIdentity, 0.5, 3, 1), 1.0, 0.0);
  }
  const SurfaceCloud nothing({}, {0.5, 3, 0.05, 8}, 1);
  CHECK(nothing.finite() == 0 && nothing.level(0).elements.empty());
  CHECK(consistent_sets({}, 0.1, 0.1, 5, 1).empty());
}

}  // namespace

void check_alignment() {
  check_trees();
  check_planes();
  check_iteration();
}
