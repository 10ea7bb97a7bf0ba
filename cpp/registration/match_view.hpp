// SPDX-License-Identifier: MIT
// The map as plain pointers, for kernels that are compiled once an instruction set.
#pragma once
#include <cstdint>

#include "maps/voxel_map.hpp"

namespace heliograph {

using SlotView = FlatIndex::Slot;
using PlaneView = Plane;
using BucketView = PointBucket;

struct IndexView {
  const SlotView* slots;
  uint64_t mask;
};

struct MapView {
  IndexView voxels;
  const PlaneView* planes;
  const Moments* moments;
  IndexView point_index;
  const BucketView* buckets;
  double voxel;
  double point_size;
  double max_thickness;
  int levels;
};

struct MatchInput {
  MapView map;
  const float* points;
  const float* before_end;  // null: no columns of the motion
  const double* T_odom_body;
  const double* T_body_lidar;
  const double* T_odom_body_first;
  double gate, kernel, sigma, fallback_range;
  int fallback_stride, columns;
};

constexpr int kRow = 18;      // errors at most: pose, motion, mounting, six each
constexpr int kFeigned = 24;  // numbers of the information that noise of the normals feigns, for each power of time; 21 in use

struct NormalSums {
  double information[kRow * kRow];
  double gradient[kRow];
  double feigned[3 * kFeigned];
  double feigned_square;
  double weight, robust_weight, square, cost;
  int64_t matches, fallback_matches;
};

// One set of entry points an instruction set; a chunk is the unit that is summed in a fixed order.
struct MatchKernels {
  void (*planes)(const MatchInput&, uint64_t begin, uint64_t end, NormalSums*);
  void (*points)(const MatchInput&, uint64_t begin, uint64_t end, NormalSums*);
  void (*query)(const MatchInput&, const double* points, uint64_t begin, uint64_t end, float* normal, double* point,
                float* variance, float* tilt, float* scatter, float* since, uint8_t* source);
};

MatchKernels baseline_match_kernels();
#if defined(HELIOGRAPH_HAVE_AVX2)
MatchKernels avx2_match_kernels();
#endif

}  // namespace heliograph
