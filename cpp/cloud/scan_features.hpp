// SPDX-License-Identifier: MIT
// Edge and planar points of a sweep by the curvature of its scan lines (J. Zhang, S. Singh, "LOAM", RSS 2014, section V-A).
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

struct ScanFeatureSettings {
  int window;            // points on either side that curvature is taken over
  int region;            // points of a sub-region of a line, about
  double edge_curvature; // least curvature of an edge, and ...
  double plane_curvature;// ... largest of a planar point: the offset from the neighbours' mean over the range
  double noise;          // of a range [m]; an offset within three times that is no edge
  int edges, planes;     // of each sub-region, to match
  int map_edges;         // of each sub-region, for the map
  int map_stride;        // every such planar point goes into the map
  double gap;            // of ranges from one point to the next that hides what is behind [m]
  double grazing;        // change of range on both sides, as a share of it, of a surface along the beam
};

// Indices of points. What is matched is part of what goes into the map, for edges at least.
struct ScanFeatures {
  std::vector<int32_t> edges, planes, map_edges, map_planes;
};

// `order` and `starts` are those of ScanLines.
ScanFeatures scan_features(std::span<const float> points, std::span<const int32_t> order, std::span<const int32_t> starts,
                           const ScanFeatureSettings& settings, int threads);

}  // namespace heliograph
