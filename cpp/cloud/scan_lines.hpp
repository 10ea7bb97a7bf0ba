// SPDX-License-Identifier: MIT
// The scan lines of a sweep: which points one laser measured one after another.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

struct ScanLines {
  std::vector<int32_t> order;   // indices of the points, line by line, along each line
  std::vector<int32_t> starts;  // where each line begins in `order`, and where the last one ends
  int64_t doubles = 0;          // returns left out because another one of the same beam lies farther
};

// Sorts points into lines by their row and, within a line, by time: by azimuth where a line's times are all one. Points
// that are not finite, or at the origin, are left out. Of several returns of one beam the farthest stays.
ScanLines scan_lines(std::span<const float> points, std::span<const int32_t> offsets_ns, std::span<const uint16_t> rows);

struct ElevationRows {
  std::vector<uint16_t> rows;  // of each point, from below
  bool discrete;               // whether the elevations stand apart, as those of fixed lasers do
};

// Rows by elevation: one for each group of elevations where they stand apart, else of equal height `row_height` [rad].
ElevationRows elevation_rows(std::span<const float> points, double row_height);

// Median angle between a point and the one `stride` places later [rad]; points that are not finite are skipped.
double step_angle(std::span<const float> points, size_t stride);

}  // namespace heliograph
