// SPDX-License-Identifier: MIT
// A draw without a dice: which of several points to keep must depend on the points alone, not on the order in which a
// driver stores them, and must favour no side of a surface (the nearest to some centre would pull towards it).
#pragma once
#include <bit>
#include <cstdint>

namespace heliograph {

// Pseudo-random rank of a point from the bits of its coordinates without the `dropped` lowest; the lowest rank is kept.
// Dropping bits makes the rank the same for coordinates that were computed in slightly different ways.
inline uint32_t point_rank(const float* p, int dropped = 0) {
  const uint64_t x = std::bit_cast<uint32_t>(p[0]) >> dropped;
  const uint64_t y = std::bit_cast<uint32_t>(p[1]) >> dropped;
  const uint64_t z = std::bit_cast<uint32_t>(p[2]) >> dropped;
  uint64_t h = x * 0x9e3779b97f4a7c15ULL ^ y * 0xc2b2ae3d27d4eb4fULL ^ z * 0x165667b19e3779f9ULL;
  h ^= h >> 32;
  h *= 0xd6e8feb86659fd93ULL;
  return static_cast<uint32_t>(h >> 32);
}

}  // namespace heliograph
