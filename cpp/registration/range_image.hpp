// SPDX-License-Identifier: MIT
// What a scan saw, by direction: how far its beams went, and so where there was nothing.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "registration/surface_elements.hpp"

namespace heliograph {

// Elements of one cloud as a scan of another saw their places.
struct Sighting {
  size_t near = 0;      // have a counterpart
  size_t expected = 0;  // have one, or lie where the scan looked and nothing hides them
  size_t through = 0;   // have none, and the scan looked through their place at what lies behind
};

// Nearest and farthest return in cells of azimuth and elevation around the scan's origin.
class RangeImage {
 public:
  RangeImage(std::span<const float> points, double cell);

  // Of the elements of `from` at the pose T (row-major 4x4, to the scan's frame); a counterpart is an element of `to`, the
  // scan prepared, within `reach`. Level `level` of both. The trees must be there.
  Sighting sight(const SurfaceCloud& to, const SurfaceCloud& from, size_t level, const double* T, double reach,
                 int threads) const;

  // Whether the scan looked in the direction of a place, through it, or is hidden from it.
  enum class Sight : uint8_t { outside, seen, through, hidden };
  Sight look(const double* place) const;

 private:
  size_t cell_of(const double* place, double range) const;
  void widen();

  size_t columns_, rows_;
  double scale_;
  std::vector<uint8_t> occupied_;
  std::vector<float> nearest_, farthest_;  // over a cell and the eight around it
};

}  // namespace heliograph
