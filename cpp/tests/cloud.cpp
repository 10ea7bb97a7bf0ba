// SPDX-License-Identifier: MIT
#include <algorithm>
#include <limits>
#include <vector>

#include "cloud/deskew.hpp"
#include "cloud/downsample.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

struct Path {
  std::vector<int64_t> times;
  std::vector<double> R, p;
  SweepPath view() const { return {times, R.data(), p.data()}; }
};

Path straight(size_t count) {
  Path path;
  for (size_t k = 0; k < count; ++k) {
    path.times.push_back(static_cast<int64_t>(k) * 10'000'000);
    for (int i = 0; i < 9; ++i) path.R.push_back(i % 4 == 0 ? 1.0 : 0.0);
    path.p.insert(path.p.end(), {0.015 * static_cast<double>(k), 0.0, 0.0});
  }
  return path;
}

void check_deskew() {
  std::vector<float> points(3 * 9000, 3.0F);
  std::vector<int32_t> offsets(9000, 80'000'000);
  points[0] = kNaN;
  offsets[1] = std::numeric_limits<int32_t>::max();
  offsets[2] = std::numeric_limits<int32_t>::min();
  for (const size_t knots : {1, 2, 11}) {
    const Path path = straight(knots);
    const std::vector<float> one = deskew(points, offsets, path.view(), kIdentity, 1);
    const std::vector<float> two = deskew(points, offsets, path.view(), kIdentity, 2);
    CHECK(one.size() == points.size());
    for (size_t k = 3; k < one.size(); ++k) CHECK(one[k] == two[k]);
    if (knots == 11) CHECK_NEAR(one[9], 3.12F, 1e-5F);
    CHECK_NEAR(one[6], 3.0F, 1e-6F);
  }
  CHECK(deskew({}, {}, straight(2).view(), kIdentity, 2).empty());
  Path same = straight(3);
  same.times = {5, 5, 5};
  CHECK_NEAR(deskew(std::vector<float>{1, 2, 3}, std::vector<int32_t>{7}, same.view(), kIdentity, 1)[1], 2.0F, 1e-6F);
}

void check_downsample() {
  const std::vector<float> points{0.1F, 0, 0, 0.2F, 0, 0, -0.1F, 0, 0, kNaN, 0, 0, 0, kInf, 0, 1e8F, -1e8F, 1e8F};
  const std::vector<int32_t> kept = voxel_downsample(points, 0.5F);
  // In the order of the cubes; far cubes wrap round.
  CHECK(kept.size() == 3);
  CHECK(std::count(kept.begin(), kept.end(), 2) == 1 && std::count(kept.begin(), kept.end(), 5) == 1);
  CHECK(voxel_downsample({}, 0.5F).empty());
  const std::vector<int32_t> near = range_gate(points, 0.15F, 1.0F);
  CHECK(near.size() == 1 && near[0] == 1);
  CHECK(range_gate({}, 0.0F, 1.0F).empty());
}

}  // namespace

void check_cloud() {
  check_deskew();
  check_downsample();
}
