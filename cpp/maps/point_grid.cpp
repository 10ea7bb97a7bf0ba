// SPDX-License-Identifier: MIT
#include "maps/point_grid.hpp"

#include <cmath>

namespace heliograph {

void PointGrid::insert(const double* p) {
  const Cube cube{floor_index(p[0] / size_), floor_index(p[1] / size_),
                  floor_index(p[2] / size_)};
  const uint64_t key = pack(kPointLevel, cube);
  const auto [id, is_new] = index_.insert(key, static_cast<uint32_t>(buckets_.size()));
  if (is_new) buckets_.push_back({key, 0, {}});
  PointBucket& bucket = buckets_[id];
  if (bucket.count == kBucketSize) return;
  const float x = static_cast<float>(p[0] - (static_cast<double>(cube.x) + 0.5) * size_);
  const float y = static_cast<float>(p[1] - (static_cast<double>(cube.y) + 0.5) * size_);
  const float z = static_cast<float>(p[2] - (static_cast<double>(cube.z) + 0.5) * size_);
  for (uint32_t k = 0; k < bucket.count; ++k) {
    const float dx = bucket.xyz[3 * k] - x, dy = bucket.xyz[3 * k + 1] - y, dz = bucket.xyz[3 * k + 2] - z;
    if (dx * dx + dy * dy + dz * dz < spacing2_) return;
  }
  float* slot = bucket.xyz + 3 * bucket.count++;
  slot[0] = x;
  slot[1] = y;
  slot[2] = z;
}

void PointGrid::prune(const double* centre, double radius) {
  std::vector<PointBucket> kept;
  FlatIndex index;
  for (const PointBucket& bucket : buckets_) {
    const Cube cube = unpack(bucket.key);
    const double dx = (static_cast<double>(cube.x) + 0.5) * size_ - centre[0];
    const double dy = (static_cast<double>(cube.y) + 0.5) * size_ - centre[1];
    const double dz = (static_cast<double>(cube.z) + 0.5) * size_ - centre[2];
    if (dx * dx + dy * dy + dz * dz > radius * radius) continue;
    index.insert(bucket.key, static_cast<uint32_t>(kept.size()));
    kept.push_back(bucket);
  }
  buckets_ = std::move(kept);
  index_ = std::move(index);
}

}  // namespace heliograph
