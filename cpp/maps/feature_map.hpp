// SPDX-License-Identifier: MIT
// A map of feature points: one mean a cube, and the line or the plane through those nearest to a place.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "util/flat_index.hpp"

namespace heliograph {

enum class FeatureKind { edge, plane };

struct FeatureMapSettings {
  FeatureKind kind;
  double voxel;          // edge of the cubes [m]
  int max_points;        // a cube that holds as many is frozen
  int neighbours;        // means at most that a line or a plane is laid through
  double reach;          // how far they may be [m]
  double max_thickness;  // largest standard deviation of them off it [m]
  double min_spread;     // smallest standard deviation of them along it [m]
};

// The line or plane near a query; `axis` is the line's direction or the plane's normal, `point` lies on it.
struct FeatureMatch {
  double axis[3];
  double point[3];
  double variance;  // of it at the query, across itself [m^2]
  double tilt;      // of its axis about either direction across [rad^2]
  bool found;
};

class FeatureMap {
 public:
  explicit FeatureMap(const FeatureMapSettings& settings);

  // Adds points of the body frame at pose T_odom_body (row-major 4x4); returns the share of the coarse cubes touched that
  // were new.
  double insert(std::span<const float> points_body, const double* T_odom_body);

  // Keeps the cubes within `radius` of `centre`, and of those at most `max_cells`, the nearest.
  void prune(const double* centre, double radius, size_t max_cells);
  void clear();

  FeatureMatch match(const double* query_odom, double sigma) const;

  // Its state as bytes, and an empty map of the same settings that takes it up: both then go on to the same bits.
  std::vector<uint8_t> save() const;
  void load(std::span<const uint8_t> bytes);

  FeatureKind kind() const { return settings_.kind; }
  size_t size() const { return cells_.size(); }
  size_t bytes() const { return index_.bytes() + coarse_.bytes() + cells_.capacity() * sizeof(Cell) + coarse_cells_.capacity() * sizeof(Coarse); }
  // (M, 4): mean and number of points of each cube.
  std::vector<double> cells() const;

 private:
  struct Cell {
    uint64_t key;
    float mean[3];  // relative to the cube's centre
    float count;
  };
  struct Coarse {
    uint64_t key;
    uint32_t touched;
  };
  struct Step {
    int8_t x, y, z;
  };
  // Where a cell's mean lies; of the cubes that share its key the one nearest to `near`.
  void place(const Cell& cell, const Cube& near, double* out) const;

  FeatureMapSettings settings_;
  FlatIndex index_, coarse_;
  std::vector<Cell> cells_;
  std::vector<Coarse> coarse_cells_;
  std::vector<Step> steps_;  // to the cubes around, near ones first
  uint32_t insertions_ = 0;
  Cube last_{0, 0, 0};  // a point was put in here last
};

}  // namespace heliograph
