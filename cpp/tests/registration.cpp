// SPDX-License-Identifier: MIT
#include "registration/point_to_plane.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include "tests/check.hpp"

using namespace heliograph;

namespace {

const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
const MatchSettings kSettings{0.2, 0.1, 0.03, 1, 0.6, {true, false}};
const MatchSettings kMounting{0.2, 0.1, 0.03, 1, 0.6, {false, true}};
const MatchSettings kNear{0.9, 0.1, 0.03, 1, 0.6, {false, true}};  // of each cube and scan only one raw point is kept
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

VoxelMap floor_map() {
  VoxelMap map({0.5, 3, 8, 200, 0.05, 0.1, 0.1});
  std::vector<float> points;
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 100; ++j)
      points.insert(points.end(), {0.1F * static_cast<float>(i) + 0.05F, 0.1F * static_cast<float>(j) + 0.05F, 0.2F});
  map.insert(points, kIdentity);
  return map;
}

void check_floor() {
  const VoxelMap map = floor_map();
  std::vector<float> points;
  for (int k = 0; k < 2000; ++k)
    points.insert(points.end(), {0.004F * static_cast<float>(k) + 1.0F, 5.0F, 0.25F});
  const std::vector<float> before(2000, 0.05F);
  const NormalEquations one = match_planes(map, {points, before, kIdentity, nullptr, nullptr}, kSettings, 1);
  const NormalEquations two = match_planes(map, {points, before, kIdentity, nullptr, nullptr}, kSettings, 2);
  CHECK(one.matches == 2000 && two.matches == 2000);
  for (int i = 0; i < 144; ++i) CHECK(one.information[i] == two.information[i]);
  CHECK_NEAR(std::sqrt(one.square / one.robust_weight), 0.05, 1e-5);
  CHECK_NEAR(one.gradient[5] / one.weight, 0.05, 1e-5);
  CHECK_NEAR(one.gradient[8] / one.weight, -0.05 * 0.05, 1e-6);
  CHECK_NEAR(one.information[12 * 3 + 3], 0.0, 1e-6 * one.weight);
  const NormalEquations near = match_points(map, {points, {}, kIdentity, kIdentity, kIdentity}, kNear, 2);
  CHECK(near.matches == 2000);
  CHECK_NEAR(near.information[12 * 3 + 3], near.information[12 * 5 + 5], 1e-9);
}

void check_odd_inputs() {
  const VoxelMap map = floor_map();
  const VoxelMap empty({0.5, 3, 8, 200, 0.05, 0.1, 0.1});
  const std::vector<float> odd{kNaN, 0, 0, 1e9F, 1e9F, -1e9F, 5.0F, 5.0F, 0.2F};
  for (const VoxelMap* some : {&map, &empty}) {
    const int64_t expected = some == &map ? 1 : 0;
    CHECK(match_planes(*some, {odd, {}, kIdentity, kIdentity, kIdentity}, kMounting, 2).matches == expected);
    CHECK(match_points(*some, {odd, {}, kIdentity, kIdentity, kIdentity}, kNear, 2).matches == expected);
    CHECK(match_planes(*some, {{}, {}, kIdentity, kIdentity, kIdentity}, kMounting, 2).matches == 0);
  }
}

void check_query() {
  const VoxelMap map = floor_map();
  const std::vector<double> queries{5.0, 5.0, 0.25, 5.0, 5.0, 3.0, -1e7, 1e7, 0.0};
  std::vector<float> normal(9), variance(3), tilt(3), scatter(3), since(3);
  std::vector<double> point(9);
  std::vector<uint8_t> source(3);
  query_planes(map, queries, kSettings, {normal.data(), point.data(), variance.data(), tilt.data(), scatter.data(), since.data(), source.data()});
  CHECK(source[0] == 1 && source[1] == 0 && source[2] == 0);
  CHECK_NEAR(std::abs(normal[2]), 1.0F, 1e-5F);
  CHECK_NEAR(point[2], 0.2, 1e-5);
  CHECK(variance[0] > 0.0F && tilt[0] > 0.0F && tilt[0] < 1e-2F);
  CHECK(since[0] == 1.0F && since[1] == -1.0F && scatter[0] >= variance[0] && scatter[1] < 0.0F);
  query_planes(map, {}, kSettings, {nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr});
}

}  // namespace

void check_registration() {
  check_floor();
  check_odd_inputs();
  check_query();
}
