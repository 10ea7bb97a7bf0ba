// SPDX-License-Identifier: MIT
// The state of local maps as bytes: what a run that was cut off goes on from, to the bit.
#include <stdexcept>

#include "maps/feature_map.hpp"
#include "maps/point_grid.hpp"
#include "maps/voxel_map.hpp"
#include "util/byte_stream.hpp"

namespace heliograph {

namespace {

constexpr uint32_t kFullBit = ~kSeenMask;
constexpr int64_t kFarCube = int64_t{1} << 52;  // beyond it a double does not tell cubes apart

// Key and marks of the entry whose value is `id`.
void put_slot(ByteWriter& to, const FlatIndex& index, uint64_t key) {
  const FlatIndex::Slot* slot = index.find(key);
  to.put(key);
  to.put(static_cast<uint32_t>((slot->full != 0 ? kFullBit : 0) | slot->seen));
}

// Makes the entry again and returns its key; one that is there twice, or was met by an insertion that is still to come, is
// damage.
uint64_t get_slot(ByteReader& from, FlatIndex& index, size_t id, uint32_t insertions) {
  const auto key = from.get<uint64_t>();
  const auto marks = from.get<uint32_t>();
  if (key == kNoKey || (marks & kSeenMask) > (insertions & kSeenMask)) damaged_state();
  const auto [slot, is_new] = index.place(key, static_cast<uint32_t>(id));
  if (!is_new) damaged_state();
  if ((marks & kFullBit) != 0) slot->full = 1;
  slot->seen = marks & kSeenMask;
  return key;
}

}  // namespace

void PointGrid::save(ByteWriter& to) const {
  to.put(static_cast<uint64_t>(buckets_.size()));
  for (const PointBucket& bucket : buckets_) {
    put_slot(to, index_, bucket.key);
    to.put(bucket.count);
    to.put_all<float>(bucket.x);
    to.put_all<float>(bucket.y);
    to.put_all<float>(bucket.z);
  }
}

void PointGrid::load(ByteReader& from, uint32_t insertions) {
  const size_t count = from.count(sizeof(PointBucket) - sizeof(uint32_t));
  buckets_.reserve(count);
  for (size_t id = 0; id < count; ++id) {
    PointBucket bucket{};
    bucket.key = get_slot(from, index_, id, insertions);
    bucket.count = from.get<uint32_t>();
    if (key_level(bucket.key) != kPointLevel || bucket.count > static_cast<uint32_t>(kBucketSize)) damaged_state();
    from.get_all<float>(bucket.x);
    from.get_all<float>(bucket.y);
    from.get_all<float>(bucket.z);
    buckets_.push_back(bucket);
  }
}

std::vector<uint8_t> VoxelMap::save() const {
  ByteWriter to;
  to.put(insertions_);
  to.put(static_cast<uint64_t>(moments_.size()));
  for (size_t id = 0; id < moments_.size(); ++id) {
    const Moments& m = moments_[id];
    const Plane& plane = planes_[id];
    put_slot(to, index_, m.key);
    to.put(m.count);
    to.put(m.fitted);
    to.put_all<float>(m.sum);
    to.put_all<float>(m.outer);
    to.put(m.touched);
    to.put(m.since);
    to.put_all<float>(plane.normal);
    to.put_all<float>(plane.centroid);
    to.put(plane.variance);
    to.put(plane.inv_spread);
  }
  points_.save(to);
  return to.take();
}

void VoxelMap::load(std::span<const uint8_t> bytes) {
  if (!planes_.empty() || insertions_ != 0) throw std::invalid_argument("only an empty map can load a state");
  ByteReader from(bytes);
  insertions_ = from.get<uint32_t>();
  const size_t count = from.count(sizeof(Moments) + sizeof(Plane));
  planes_.reserve(count);
  moments_.reserve(count);
  for (size_t id = 0; id < count; ++id) {
    Moments m{};
    Plane plane{};
    m.key = get_slot(from, index_, id, insertions_);
    m.count = from.get<float>();
    m.fitted = from.get<float>();
    from.get_all<float>(m.sum);
    from.get_all<float>(m.outer);
    m.touched = from.get<uint32_t>();
    m.since = from.get<float>();
    from.get_all<float>(plane.normal);
    from.get_all<float>(plane.centroid);
    plane.variance = from.get<float>();
    plane.inv_spread = from.get<float>();
    if (key_level(m.key) >= static_cast<uint64_t>(settings_.levels) || m.touched > insertions_) damaged_state();
    moments_.push_back(m);
    planes_.push_back(plane);
  }
  points_.load(from, insertions_);
  from.expect_end();
}

std::vector<uint8_t> FeatureMap::save() const {
  ByteWriter to;
  to.put(insertions_);
  for (const int64_t number : {last_.x, last_.y, last_.z}) to.put(number);
  to.put(static_cast<uint64_t>(cells_.size()));
  for (const Cell& cell : cells_) {
    to.put(cell.key);
    to.put_all<float>(cell.mean);
    to.put(cell.count);
  }
  to.put(static_cast<uint64_t>(coarse_cells_.size()));
  for (const Coarse& coarse : coarse_cells_) {
    to.put(coarse.key);
    to.put(coarse.touched);
  }
  return to.take();
}

void FeatureMap::load(std::span<const uint8_t> bytes) {
  if (!cells_.empty() || insertions_ != 0) throw std::invalid_argument("only an empty map can load a state");
  ByteReader from(bytes);
  insertions_ = from.get<uint32_t>();
  for (int64_t* number : {&last_.x, &last_.y, &last_.z}) {
    *number = from.get<int64_t>();
    if (*number > kFarCube || *number < -kFarCube) damaged_state();
  }
  const size_t count = from.count(sizeof(uint64_t) + 4 * sizeof(float));
  for (size_t id = 0; id < count; ++id) {
    Cell cell{};
    cell.key = from.get<uint64_t>();
    from.get_all<float>(cell.mean);
    cell.count = from.get<float>();
    if (cell.key == kNoKey || key_level(cell.key) != 0 || !(cell.count > 0.0F)) damaged_state();
    if (!index_.insert(cell.key, static_cast<uint32_t>(id)).second) damaged_state();
    cells_.push_back(cell);
  }
  const size_t places = from.count(sizeof(uint64_t) + sizeof(uint32_t));
  for (size_t id = 0; id < places; ++id) {
    Coarse coarse{};
    coarse.key = from.get<uint64_t>();
    coarse.touched = from.get<uint32_t>();
    if (coarse.key == kNoKey || coarse.touched > insertions_) damaged_state();
    if (!coarse_.insert(coarse.key, static_cast<uint32_t>(id)).second) damaged_state();
    coarse_cells_.push_back(coarse);
  }
  from.expect_end();
}

}  // namespace heliograph
