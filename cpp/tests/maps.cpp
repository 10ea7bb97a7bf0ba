// SPDX-License-Identifier: MIT
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "maps/feature_map.hpp"
#include "maps/global_map.hpp"
#include "maps/voxel_map.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
const VoxelMapSettings kSettings{0.5, 3, 8, 200, 0.05, 0.1, 0.1};
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// A floor of side x side metres, 100 points a square metre.
std::vector<float> floor_points(int side) {
  std::vector<float> points;
  for (int i = 0; i < 10 * side; ++i)
    for (int j = 0; j < 10 * side; ++j)
      points.insert(points.end(), {0.1F * static_cast<float>(i) + 0.05F, 0.1F * static_cast<float>(j) + 0.05F, 0.2F});
  return points;
}

size_t count_planes(const VoxelMap& map) {
  size_t planes = 0;
  for (const Plane& plane : map.planes()) planes += plane.variance >= 0.0F ? 1 : 0;
  return planes;
}

void check_growth_and_prune() {
  VoxelMap map(kSettings);
  map.insert({}, kIdentity);
  map.prune(kIdentity, 10.0, 100);
  CHECK(map.size() == 0);
  map.insert(floor_points(40), kIdentity);  // 80 x 80 cubes and their parents: the table grows several times
  CHECK(map.size() == 6400 + 1600 + 400);
  CHECK(count_planes(map) > 6000);
  for (const Plane& plane : map.planes())
    if (plane.variance >= 0.0F) CHECK_NEAR(std::abs(plane.normal[2]), 1.0F, 1e-3F);
  const double centre[3] = {20.0, 20.0, 0.0};
  map.prune(centre, 10.0, 1'000'000);
  CHECK(map.size() > 1000 && map.size() < 3000);
  map.prune(centre, 10.0, 100);
  CHECK(map.size() >= 100 && map.size() < 120);  // cubes equally far are kept together
  map.insert(floor_points(40), kIdentity);
  CHECK(map.size() == 8400);
  const double nowhere[3] = {1e6, 0.0, 0.0};
  map.prune(nowhere, 10.0, 0);
  CHECK(map.size() == 0 && map.bytes() > 0);
}

void check_odd_points() {
  VoxelMap map(kSettings);
  const std::vector<float> odd{kNaN, 0, 0, 1, 2, 3, 0, std::numeric_limits<float>::infinity(), 0};
  map.insert(odd, kIdentity);
  CHECK(map.size() == 3);  // one finite point on three levels
  const std::vector<float> far{1e9F, -1e9F, 1e9F, -131'000.0F, 131'000.0F, 0.0F};
  map.insert(far, kIdentity);
  CHECK(map.size() == 9);
  for (int k = 0; k < 50; ++k) map.insert(std::vector<float>(9, 1.0F), kIdentity);  // one place, again and again
  CHECK(count_planes(map) == 0);
}

void check_global() {
  GlobalMap map(0.2);
  map.insert({}, {}, kIdentity);
  CHECK(map.size() == 0 && map.points().empty());
  const std::vector<float> points{0.05F, 0.05F, 0.05F, 0.15F, 0.05F, 0.05F, kNaN, 0, 0, -0.05F, 0, 0};
  const std::vector<float> intensity{10.0F, 20.0F, 99.0F, 7.0F};
  map.insert(points, intensity, kIdentity);
  CHECK(map.size() == 2);
  CHECK_NEAR(map.points()[0], 0.1F, 1e-6F);
  CHECK_NEAR(map.intensity()[0], 15.0F, 1e-5F);
  CHECK(map.counts()[1] == 1.0F);
  map.insert(floor_points(60), {}, kIdentity);
  CHECK(map.size() > 80'000);
}

void check_global_merge() {
  GlobalMap part(0.2), whole(0.2);
  part.insert(floor_points(4), {}, kIdentity);
  const std::vector<int32_t> cubes = part.cubes();
  const std::vector<float> sums = part.sums(), intensity = part.intensity_sums(), counts = part.counts();
  whole.merge({cubes, sums, intensity, counts}, nullptr, 0);
  whole.merge({cubes, sums, intensity, counts}, kIdentity, 0);
  CHECK(whole.size() == part.size() && whole.counts()[0] == 2.0F * part.counts()[0]);
  whole.merge({{}, {}, {}, {}}, nullptr, 0);
  whole.clear();
  CHECK(whole.size() == 0);
  whole.merge({cubes, sums, intensity, counts}, nullptr, 0);
  CHECK(whole.points() == part.points());
}

void check_surfaces() {
  GlobalMap map(0.1);
  CHECK(map.surfaces(0.02, 2).counts.empty());
  map.insert(std::vector<float>{50.0F, 0.0F, 0.0F}, {}, kIdentity);
  std::vector<float> wall;  // 12 mm above a border and below it by turns
  for (int i = 0; i < 400; ++i)
    for (int j = 0; j < 400; ++j)
      wall.insert(wall.end(), {0.025F * static_cast<float>(i) + 0.01F, 0.025F * static_cast<float>(j) + 0.01F,
                               (i + j) % 2 == 0 ? 0.012F : -0.012F});
  map.insert(wall, {}, kIdentity);
  const SurfacePoints found = map.surfaces(0.02, 2);
  CHECK(map.size() == 20'001 && found.counts.size() == 10'001);
  CHECK(found.points == map.surfaces(0.02, 1).points);
  CHECK(found.points[0] == map.points()[0] && found.points[2] == map.points()[2]);
  for (size_t k = 1; k < found.counts.size(); ++k) CHECK_NEAR(found.points[3 * k + 2], 0.0F, 1e-4F);
}

// A map goes on from its state to the same bits, and one that was cut short or spoilt is refused or does no harm.
template <typename Map, typename Settings>
void check_state(const Settings& settings) {
  Map map(settings), again(settings);
  map.insert(floor_points(4), kIdentity);
  const std::vector<uint8_t> state = map.save();
  again.load(state);
  CHECK(again.save() == state && again.size() == map.size());
  for (Map* one : {&map, &again}) one->insert(floor_points(5), kIdentity);
  CHECK(again.save() == map.save());
  for (size_t cut = 0; cut < state.size(); cut += 97) {
    Map none(settings);
    bool refused = false;
    try {
      none.load(std::span(state).first(cut));
    } catch (const std::invalid_argument&) {
      refused = true;
    }
    CHECK(refused);
  }
  for (size_t at = 0; at < state.size(); at += 61) {
    std::vector<uint8_t> spoilt = state;
    spoilt[at] ^= 0xff;
    Map other(settings);
    try {
      other.load(spoilt);
    } catch (const std::invalid_argument&) {
      continue;
    }
    other.insert(floor_points(4), kIdentity);
    const double centre[3] = {0.0, 0.0, 0.0};
    other.prune(centre, 100.0, 1000);
  }
}

}  // namespace

void check_maps() {
  check_growth_and_prune();
  check_odd_points();
  check_global();
  check_global_merge();
  check_surfaces();
  check_state<VoxelMap>(kSettings);
  check_state<FeatureMap>(FeatureMapSettings{FeatureKind::plane, 0.4, 30, 8, 1.0, 0.1, 0.1});
}
