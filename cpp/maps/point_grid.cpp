// SPDX-License-Identifier: MIT
#include "maps/point_grid.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace heliograph {

namespace {
constexpr size_t kBatch = 16;
constexpr uint32_t kFull = ~uint32_t{0};
}  // namespace

void PointGrid::insert(std::span<const double* const> points) {
  std::array<Entry, kBatch> entries;
  for (size_t begin = 0; begin < points.size(); begin += kBatch) {
    const size_t batch = std::min(kBatch, points.size() - begin);
    for (size_t k = 0; k < batch; ++k) {
      const double* p = points[begin + k];
      entries[k].cube = {floor_index(p[0] / size_), floor_index(p[1] / size_), floor_index(p[2] / size_)};
      index_.prefetch(pack(kPointLevel, entries[k].cube));
    }
    for (size_t k = 0; k < batch; ++k) {
      const uint64_t key = pack(kPointLevel, entries[k].cube);
      const auto [slot, is_new] = index_.place(key, static_cast<uint32_t>(buckets_.size()));
      if (is_new) buckets_.push_back({key, 0, {}, {}, {}});
      entries[k].id = slot->full != 0 ? kFull : slot->value;
      if (slot->full == 0) {
        const auto* lines = reinterpret_cast<const char*>(buckets_.data() + slot->value);
        for (size_t at = 0; at < sizeof(PointBucket); at += 64) __builtin_prefetch(lines + at, 1);
      }
    }
    for (size_t k = 0; k < batch; ++k)
      if (entries[k].id != kFull) add(points[begin + k], entries[k]);
  }
}

void PointGrid::add(const double* p, const Entry& entry) {
  PointBucket& bucket = buckets_[entry.id];
  if (bucket.count == kBucketSize) return;  // another point of this batch filled it
  const float x = static_cast<float>(p[0] - (static_cast<double>(entry.cube.x) + 0.5) * size_);
  const float y = static_cast<float>(p[1] - (static_cast<double>(entry.cube.y) + 0.5) * size_);
  const float z = static_cast<float>(p[2] - (static_cast<double>(entry.cube.z) + 0.5) * size_);
  float d2[kBucketSize];
  for (int k = 0; k < kBucketSize; ++k) {  // all of them, so that the loop vectorises
    const float dx = bucket.x[k] - x, dy = bucket.y[k] - y, dz = bucket.z[k] - z;
    d2[k] = dx * dx + dy * dy + dz * dz;
  }
  for (uint32_t k = 0; k < bucket.count; ++k)
    if (d2[k] < spacing2_) return;
  bucket.x[bucket.count] = x;
  bucket.y[bucket.count] = y;
  bucket.z[bucket.count] = z;
  if (++bucket.count == kBucketSize) index_.place(bucket.key, entry.id).first->full = 1;
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
    index.place(bucket.key, static_cast<uint32_t>(kept.size())).first->full = bucket.count == kBucketSize ? 1 : 0;
    kept.push_back(bucket);
  }
  buckets_ = std::move(kept);
  index_ = std::move(index);
}

}  // namespace heliograph
