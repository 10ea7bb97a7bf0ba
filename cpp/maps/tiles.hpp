// SPDX-License-Identifier: MIT
// Which cells of a map lie in, or close to, which large cube of space.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

struct TileSplit {
  std::vector<int32_t> tiles;   // (T, 3) index of each tile along the axes, in the order in which cells reach them
  std::vector<uint32_t> begin;  // (T + 1,) where each tile's cells begin in `cells`
  std::vector<uint32_t> cells;  // (L,) indices of cells, ascending within a tile
};

// Splits cubes (M, 3) by tiles of `edge` cubes. A cube within `halo` of a tile belongs to it too.
TileSplit split_tiles(std::span<const int32_t> cubes, int32_t edge, int32_t halo);

}  // namespace heliograph
