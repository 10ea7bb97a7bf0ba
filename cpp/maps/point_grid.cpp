// SPDX-License-Identifier: MIT
#include "maps/point_grid.hpp"

#include <algorithm>

namespace heliograph {

PointGrid::Place PointGrid::place(const double* p) const {
  const Cube cube{floor_index(p[0] / size_), floor_index(p[1] / size_), floor_index(p[2] / size_)};
  return {pack(kPointLevel, cube),
          {static_cast<float>(p[0] - (static_cast<double>(cube.x) + 0.5) * size_),
           static_cast<float>(p[1] - (static_cast<double>(cube.y) + 0.5) * size_),
           static_cast<float>(p[2] - (static_cast<double>(cube.z) + 0.5) * size_)}};
}

bool PointGrid::has_room(const PointBucket& bucket, const float* xyz) const {
  if (bucket.count == kBucketSize) return false;
  for (uint32_t k = 0; k < bucket.count; ++k) {
    const float* other = bucket.xyz + 3 * k;
    const float dx = other[0] - xyz[0], dy = other[1] - xyz[1], dz = other[2] - xyz[2];
    if (dx * dx + dy * dy + dz * dz < spacing2_) return false;
  }
  return true;
}

bool PointGrid::accepts(const double* p) const {
  const Place at = place(p);
  const uint32_t* id = index_.find(at.key);
  return id == nullptr || has_room(buckets_[*id], at.xyz);
}

void PointGrid::insert(const double* p) {
  const Place at = place(p);
  const auto [id, is_new] = index_.insert(at.key, static_cast<uint32_t>(buckets_.size()));
  if (is_new) buckets_.push_back({at.key, 0, {}});
  PointBucket& bucket = buckets_[id];
  if (!has_room(bucket, at.xyz)) return;
  std::copy(at.xyz, at.xyz + 3, bucket.xyz + 3 * bucket.count++);
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
