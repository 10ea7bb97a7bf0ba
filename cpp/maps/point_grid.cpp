// SPDX-License-Identifier: MIT
#include "maps/point_grid.hpp"

#include <algorithm>
#include <array>

namespace heliograph {

namespace {
constexpr size_t kBatch = 16;
}  // namespace

PointGrid::Place PointGrid::place(const double* p) const {
  const Cube cube{floor_index(p[0] / size_), floor_index(p[1] / size_), floor_index(p[2] / size_)};
  return {pack(kPointLevel, cube),
          {static_cast<float>(p[0] - (static_cast<double>(cube.x) + 0.5) * size_),
           static_cast<float>(p[1] - (static_cast<double>(cube.y) + 0.5) * size_),
           static_cast<float>(p[2] - (static_cast<double>(cube.z) + 0.5) * size_)}};
}

bool PointGrid::has_room(const PointBucket& bucket, const float* xyz) const {
  if (bucket.count == kBucketSize) return false;
  float d2[kBucketSize];
  for (int k = 0; k < kBucketSize; ++k) {  // all of them, so that the loop vectorises
    const float dx = bucket.x[k] - xyz[0], dy = bucket.y[k] - xyz[1], dz = bucket.z[k] - xyz[2];
    d2[k] = dx * dx + dy * dy + dz * dz;
  }
  for (uint32_t k = 0; k < bucket.count; ++k)
    if (d2[k] < spacing2_) return false;
  return true;
}

void PointGrid::accepts(std::span<const double* const> points, uint32_t insertion, bool* answers) {
  std::array<Place, kBatch> places;
  std::array<FlatIndex::Slot*, kBatch> slots;
  for (size_t begin = 0; begin < points.size(); begin += kBatch) {
    const size_t batch = std::min(kBatch, points.size() - begin);
    for (size_t k = 0; k < batch; ++k) {
      places[k] = place(points[begin + k]);
      index_.prefetch(places[k].key);
    }
    for (size_t k = 0; k < batch; ++k) {
      slots[k] = index_.find(places[k].key);
      if (slots[k] == nullptr) continue;
      slots[k]->seen = insertion & kSeenMask;
      if (slots[k]->full != 0) continue;
      const auto* lines = reinterpret_cast<const char*>(buckets_.data() + slots[k]->value);
      for (size_t at = 0; at < sizeof(PointBucket); at += 64) __builtin_prefetch(lines + at);
    }
    for (size_t k = 0; k < batch; ++k)
      answers[begin + k] =
          slots[k] == nullptr || (slots[k]->full == 0 && has_room(buckets_[slots[k]->value], places[k].xyz));
  }
}

void PointGrid::insert(const double* p, uint32_t insertion) {
  const Place at = place(p);
  const auto [slot, is_new] = index_.place(at.key, static_cast<uint32_t>(buckets_.size()));
  if (is_new) buckets_.push_back({at.key, 0, {}, {}, {}});
  slot->seen = insertion & kSeenMask;
  PointBucket& bucket = buckets_[slot->value];
  if (!has_room(bucket, at.xyz)) return;
  bucket.x[bucket.count] = at.xyz[0];
  bucket.y[bucket.count] = at.xyz[1];
  bucket.z[bucket.count] = at.xyz[2];
  if (++bucket.count == kBucketSize) slot->full = 1;
}

void PointGrid::prune(const double* centre, double radius) {
  std::vector<uint8_t> wanted(buckets_.size());
  const Cube near = cube_at(centre, size_);
  for (size_t id = 0; id < buckets_.size(); ++id) {
    const Cube cube = unpack_near(buckets_[id].key, near);
    const double dx = (static_cast<double>(cube.x) + 0.5) * size_ - centre[0];
    const double dy = (static_cast<double>(cube.y) + 0.5) * size_ - centre[1];
    const double dz = (static_cast<double>(cube.z) + 0.5) * size_ - centre[2];
    wanted[id] = dx * dx + dy * dy + dz * dz <= radius * radius ? 1 : 0;
  }
  keep(wanted);
}

void PointGrid::forget_before(uint32_t oldest) {
  keep(index_.seen_since(oldest));
}

void PointGrid::keep(const std::vector<uint8_t>& wanted) {
  const auto kept = static_cast<size_t>(std::count(wanted.begin(), wanted.end(), 1));
  if (kept == wanted.size()) return;
  if (FlatIndex::few(wanted.size() - kept, wanted.size())) {
    for (size_t id = wanted.size(); id-- > 0;) {
      if (wanted[id] != 0) continue;
      index_.erase(buckets_[id].key);
      if (id + 1 < buckets_.size()) {
        buckets_[id] = buckets_.back();
        index_.find(buckets_[id].key)->value = static_cast<uint32_t>(id);
      }
      buckets_.pop_back();
    }
    return;
  }
  index_.keep(wanted);
  size_t next = 0;
  for (size_t id = 0; id < wanted.size(); ++id)
    if (wanted[id] != 0) buckets_[next++] = buckets_[id];
  buckets_.resize(next);
}

}  // namespace heliograph
