// SPDX-License-Identifier: MIT
// The local map: cubes on several levels, each with running moments and the plane that they make.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "maps/point_grid.hpp"
#include "util/flat_index.hpp"

namespace heliograph {

struct VoxelMapSettings {
  double voxel;           // edge of the finest cube [m]; each level doubles it
  int levels;             // 1 to 8
  int min_points;         // a plane needs as many
  int max_points;         // a cube that holds as many after an insertion is frozen
  double max_thickness;   // largest standard deviation across a plane [m]
  double min_spread;      // smallest standard deviation along it, as a share of the cube's edge
  double point_spacing;   // of the raw points kept for the nearest-neighbour fallback [m]
};

// What a query reads: one half of a cache line.
struct Plane {
  float normal[3];
  float centroid[3];   // relative to the cube's centre
  float variance;      // of the centroid across the plane [m^2]; negative: no plane
  float inv_spread;    // variance of the normal about either axis across it by `variance` [1/m^2]; of a plane on its own,
                       // 1 / its smaller variance along itself: how fast its uncertainty grows away from it
};

struct Moments {
  uint64_t key;
  float count;
  float fitted;        // count at the last fit
  float sum[3];        // relative to the cube's centre
  float outer[6];      // xx xy xz yy yz zz
  uint32_t touched;    // number of the last insertion that added to it
  float since;         // mean number of the insertions that its points came with
};

class VoxelMap {
 public:
  explicit VoxelMap(const VoxelMapSettings& settings);

  // Adds points of the body frame at pose T_odom_body (row-major 4x4) and refits the planes that changed enough. Returns
  // which share of the coarsest cubes touched was new: how much of the scan extends the map.
  double insert(std::span<const float> points_body, const double* T_odom_body);

  // Keeps the cubes within `radius` of `centre`, and of those at most `max_voxels`, the nearest.
  void prune(const double* centre, double radius, size_t max_voxels);

  // Keeps the cubes that a point of one of the last `insertions` insertions lay in, frozen ones too.
  void forget_unseen(uint32_t insertions);

  // Its state as bytes, and an empty map of the same settings that takes it up: both then go on to the same bits.
  std::vector<uint8_t> save() const;
  void load(std::span<const uint8_t> bytes);

  size_t size() const { return planes_.size(); }
  size_t bytes() const;
  const VoxelMapSettings& settings() const { return settings_; }
  // The cube of a key, that of the keys alike which lies nearest to the last insertion.
  Cube cube_of(uint64_t key) const;
  double edge(uint64_t level) const { return settings_.voxel * static_cast<double>(uint64_t{1} << level); }
  const FlatIndex& index() const { return index_; }
  const std::vector<Plane>& planes() const { return planes_; }
  const std::vector<Moments>& moments() const { return moments_; }
  const PointGrid& points() const { return points_; }

 private:
  // What one scan adds to one finest cube. Gathering first means that the large tables are touched once a cube, not once
  // a point and level.
  struct Delta {
    uint64_t key;
    Cube cube;
    float count = 0.0F;
    float sum[3] = {0.0F, 0.0F, 0.0F};
    float outer[6] = {0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F};
    uint32_t rank = ~uint32_t{0};
    double raw[3] = {0.0, 0.0, 0.0};  // the point that stands for the others in the fallback's grid
  };
  struct Spot {
    double q[3];  // odom frame
    Cube cube;
    uint64_t key;  // kNoKey: not a point
    uint32_t rank;
  };
  void gather(std::span<const float> points_body, const double* T_odom_body);
  void collect(const Spot& spot);
  size_t add_batch(std::span<const Delta> deltas);
  uint32_t locate(uint64_t key, size_t* created);
  void add(const Delta& delta, uint64_t key, uint32_t id);
  void add_raw_points();
  void refit(uint32_t id);
  void lean_on_coarser(const Moments& m, Plane* plane) const;
  size_t coarse_cubes();
  void keep(const std::vector<uint8_t>& wanted);
  void drop(const std::vector<uint8_t>& wanted);

  VoxelMapSettings settings_;
  FlatIndex index_;
  std::vector<Plane> planes_;
  std::vector<Moments> moments_;
  PointGrid points_;
  // Of one insertion; kept because fresh memory costs more than what is done with it.
  FlatIndex seen_{15};
  std::vector<Delta> deltas_;
  std::vector<std::vector<uint32_t>> touched_;  // a level each
  uint32_t insertions_ = 0;
};

}  // namespace heliograph
