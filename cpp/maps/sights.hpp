// SPDX-License-Identifier: MIT
// Rays of a scan that pass through where a map has something: it is not there any more, or not yet.
#pragma once
#include <cstdint>
#include <span>

namespace heliograph {

struct SightSettings {
  float radius;   // a ray passes through a place when it passes within this of it [m]
  float reach;    // places farther from the sensor than this are left alone [m]
  float margin;   // the ray must go on for at least this behind it [m]
  float grazing;  // sine of the angle between ray and surface below which nothing is said
};

// Rays from the sensor to `ends` (B, 3), all relative to where the sensor was at the end of the sweep, axes with z up.
// `start` is where it was at the sweep's beginning: a ray counts where it passes from either end of that way.
struct Sight {
  std::span<const float> ends;
  const float* start;
};

// Adds one to the votes (M,) of the places (M, 3), relative to the sensor, that a ray passes through while none ends at
// them. `normals` (M, 3) are those of the surfaces there, zero where they are none, or empty; a ray that grazes a surface
// tells nothing of it. Of a place without a surface that lies below the sensor, ground is to be thought: a ray that would
// meet level ground there must go on for longer than it takes to rise above it.
void count_seen_through(std::span<const float> places, std::span<const float> normals, const Sight& sight,
                        const SightSettings& settings, std::span<uint16_t> votes);

}  // namespace heliograph
