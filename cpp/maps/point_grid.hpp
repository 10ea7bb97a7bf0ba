// SPDX-License-Identifier: MIT
// A sparse grid of a few well-spread raw points a cube, for nearest-neighbour queries where no plane is known.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

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

  // Adds points (odom frame) one after the other, each unless its cube is full or holds a point nearer than the spacing.
  void insert(std::span<const double* const> points);

  // Keeps the cubes whose centre lies within `radius` of `centre`.
  void prune(const double* centre, double radius);

  double size() const { return size_; }
  const FlatIndex& index() const { return index_; }
  const std::vector<PointBucket>& buckets() const { return buckets_; }
  size_t bytes() const { return index_.bytes() + buckets_.capacity() * sizeof(PointBucket); }

 private:
  struct Entry {
    Cube cube;
    uint32_t id;
  };
  void add(const double* p, const Entry& entry);

  double size_;
  float spacing2_;
  FlatIndex index_;
  std::vector<PointBucket> buckets_;
};

}  // namespace heliograph
