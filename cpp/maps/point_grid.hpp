// SPDX-License-Identifier: MIT
// A sparse grid of a few well-spread raw points a cube, for nearest-neighbour queries where no plane is known.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "util/byte_stream.hpp"
#include "util/flat_index.hpp"

namespace heliograph {

constexpr int kBucketSize = 16;
constexpr uint64_t kPointLevel = 15;

struct PointBucket {
  uint64_t key;
  uint32_t count;
  float x[kBucketSize], y[kBucketSize], z[kBucketSize];  // relative to the cube's centre
};

class PointGrid {
 public:
  PointGrid(double size, double spacing) : size_(size), spacing2_(static_cast<float>(spacing * spacing)) {}

  // For each of some points (odom frame), whether its cube is neither full nor holds a point nearer than the spacing.
  // Answers together what would be slow one by one: the table is larger than any cache. Their cubes have been seen by
  // then, in the insertion of number `insertion`.
  void accepts(std::span<const double* const> points, uint32_t insertion, bool* answers);

  // Adds a point if it would be accepted.
  void insert(const double* p, uint32_t insertion);

  // Keeps the cubes whose centre lies within `radius` of `centre`.
  void prune(const double* centre, double radius);

  // Keeps the cubes that were seen in insertion `oldest` or later.
  void forget_before(uint32_t oldest);

  // Its state, and an empty grid that takes it up; `insertions` have been made by then.
  void save(ByteWriter& to) const;
  void load(ByteReader& from, uint32_t insertions);

  double size() const { return size_; }
  const FlatIndex& index() const { return index_; }
  const std::vector<PointBucket>& buckets() const { return buckets_; }
  size_t bytes() const { return index_.bytes() + buckets_.capacity() * sizeof(PointBucket); }

 private:
  struct Place {
    uint64_t key;
    float xyz[3];  // relative to the cube's centre
  };
  Place place(const double* p) const;
  void keep(const std::vector<uint8_t>& wanted);
  bool has_room(const PointBucket& bucket, const float* xyz) const;

  double size_;
  float spacing2_;
  FlatIndex index_;
  std::vector<PointBucket> buckets_;
};

}  // namespace heliograph
