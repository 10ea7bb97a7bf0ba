// SPDX-License-Identifier: MIT
#include "cloud/downsample.hpp"

#include <cmath>

#include "util/flat_index.hpp"

namespace heliograph {

std::vector<int32_t> voxel_downsample(std::span<const float> points, float leaf) {
  const size_t count = points.size() / 3;
  const float inverse = 1.0F / leaf;
  FlatIndex seen(14);
  std::vector<int32_t> kept;
  kept.reserve(count / 4);
  uint64_t last = kNoKey;
  for (size_t k = 0; k < count; ++k) {
    const float* p = points.data() + 3 * k;
    if (!std::isfinite(p[0] + p[1] + p[2])) continue;
    const Cube cube{floor_index(p[0] * inverse), floor_index(p[1] * inverse),
                    floor_index(p[2] * inverse)};
    const uint64_t key = pack(0, cube);
    if (key == last) continue;  // neighbouring points come one after the other
    last = key;
    if (seen.insert(key, 0).second) kept.push_back(static_cast<int32_t>(k));
  }
  return kept;
}

std::vector<int32_t> range_gate(std::span<const float> points, float min_range, float max_range) {
  const size_t count = points.size() / 3;
  const float low = min_range * min_range, high = max_range * max_range;
  std::vector<int32_t> kept;
  kept.reserve(count);
  for (size_t k = 0; k < count; ++k) {
    const float* p = points.data() + 3 * k;
    const float r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    if (r2 >= low && r2 <= high) kept.push_back(static_cast<int32_t>(k));  // false for NaN
  }
  return kept;
}

}  // namespace heliograph
