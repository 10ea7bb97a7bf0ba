// SPDX-License-Identifier: MIT
#include "cloud/downsample.hpp"

#include <algorithm>
#include <cmath>

#include "util/flat_index.hpp"
#include "util/point_rank.hpp"

namespace heliograph {

std::vector<int32_t> voxel_downsample(std::span<const float> points, float leaf) {
  struct Choice {
    uint64_t key;
    uint32_t rank;
    int32_t index;
  };
  const size_t count = points.size() / 3;
  const float inverse = 1.0F / leaf;
  FlatIndex seen(14);
  std::vector<Choice> choices;
  choices.reserve(count / 4);
  for (size_t k = 0; k < count; ++k) {
    const float* p = points.data() + 3 * k;
    if (!std::isfinite(p[0] + p[1] + p[2])) continue;
    const uint64_t key = pack(0, {floor_index(p[0] * inverse), floor_index(p[1] * inverse), floor_index(p[2] * inverse)});
    const Choice candidate{key, point_rank(p), static_cast<int32_t>(k)};
    const auto [at, is_new] = seen.insert(key, static_cast<uint32_t>(choices.size()));
    if (is_new)
      choices.push_back(candidate);
    else if (candidate.rank < choices[at].rank)
      choices[at] = candidate;
  }
  std::sort(choices.begin(), choices.end(), [](const Choice& a, const Choice& b) { return a.key < b.key; });
  std::vector<int32_t> kept(choices.size());
  std::transform(choices.begin(), choices.end(), kept.begin(), [](const Choice& choice) { return choice.index; });
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
