// SPDX-License-Identifier: MIT
#include "maps/tiles.hpp"

#include <array>
#include <stdexcept>
#include <utility>

#include "util/flat_index.hpp"

namespace heliograph {

namespace {

// The tiles along one axis that a cube belongs to: its own, and the one whose border it is close to.
struct Reach {
  std::array<int64_t, 2> tile;
  size_t count;
};

Reach reach(int32_t cube, int32_t edge, int32_t halo) {
  const int64_t tile = cube >= 0 ? cube / edge : -((int64_t{edge} - 1 - cube) / edge);
  const int64_t local = cube - tile * edge;
  if (local < halo) return {{tile, tile - 1}, 2};
  if (local >= edge - halo) return {{tile, tile + 1}, 2};
  return {{tile, tile}, 1};
}

}  // namespace

TileSplit split_tiles(std::span<const int32_t> cubes, int32_t edge, int32_t halo) {
  if (edge < 1 || halo < 0 || 2 * halo > edge) throw std::invalid_argument("a tile needs an edge of at least two halos");
  TileSplit out;
  FlatIndex index(6);
  std::vector<std::pair<uint32_t, uint32_t>> members;  // tile, cell
  members.reserve(cubes.size() / 3 + cubes.size() / 12);
  for (size_t k = 0; k < cubes.size() / 3; ++k) {
    const Reach x = reach(cubes[3 * k], edge, halo), y = reach(cubes[3 * k + 1], edge, halo),
                z = reach(cubes[3 * k + 2], edge, halo);
    for (size_t a = 0; a < x.count; ++a)
      for (size_t b = 0; b < y.count; ++b)
        for (size_t c = 0; c < z.count; ++c) {
          const Cube tile{x.tile[a], y.tile[b], z.tile[c]};
          const auto [id, is_new] = index.insert(pack(0, tile), static_cast<uint32_t>(index.size()));
          if (is_new)
            for (const int64_t i : {tile.x, tile.y, tile.z}) out.tiles.push_back(static_cast<int32_t>(i));
          members.emplace_back(id, static_cast<uint32_t>(k));
        }
  }
  out.begin.assign(index.size() + 1, 0);
  for (const auto& [tile, cell] : members) ++out.begin[tile + 1];
  for (size_t t = 0; t < index.size(); ++t) out.begin[t + 1] += out.begin[t];
  out.cells.resize(members.size());
  std::vector<uint32_t> next(out.begin.begin(), out.begin.end() - 1);
  for (const auto& [tile, cell] : members) out.cells[next[tile]++] = cell;
  return out;
}

}  // namespace heliograph
