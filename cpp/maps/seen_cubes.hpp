// SPDX-License-Identifier: MIT
// Which cubes of space a map's insertions have touched, and when each was touched last.
#pragma once
#include <cstdint>
#include <vector>

#include "util/flat_index.hpp"

namespace heliograph {

class SeenCubes {
 public:
  explicit SeenCubes(double edge) : edge_(edge) {}

  double edge() const { return edge_; }
  size_t size() const { return index_.size(); }

  // The next insertion begins.
  void begin() { ++insertions_; }

  // Whether the present insertion touches the cube for the first time.
  bool touch(const Cube& cube) {
    const auto [slot, is_new] = index_.place(pack(0, cube), static_cast<uint32_t>(index_.size()));
    last_ = cube;
    const uint32_t now = insertions_ & kSeenMask;
    const bool first = is_new || slot->seen != now;
    slot->seen = insertions_ & kSeenMask;
    return first;
  }

  // Forgets, and returns, the cubes that none of the last `insertions` insertions touched.
  std::vector<Cube> forget_unseen(uint32_t insertions) {
    const uint32_t oldest = insertions_ >= insertions ? insertions_ - insertions + 1 : 0;
    return forget(index_.seen_since(oldest));
  }

  // Forgets the cubes whose centres lie farther than `radius` from `centre`.
  void prune(const double* centre, double radius) {
    std::vector<uint8_t> wanted(index_.size());
    last_ = cube_at(centre, edge_);
    for (size_t i = 0; i <= index_.mask(); ++i) {
      const FlatIndex::Slot& slot = index_.slots()[i];
      if (slot.key == kNoKey) continue;
      const Cube cube = unpack_near(slot.key, last_);
      const double x = (static_cast<double>(cube.x) + 0.5) * edge_ - centre[0];
      const double y = (static_cast<double>(cube.y) + 0.5) * edge_ - centre[1];
      const double z = (static_cast<double>(cube.z) + 0.5) * edge_ - centre[2];
      wanted[slot.value] = x * x + y * y + z * z <= radius * radius ? 1 : 0;
    }
    forget(wanted);
  }

  void clear() { index_.clear(); }

 private:
  std::vector<Cube> forget(const std::vector<uint8_t>& wanted) {
    std::vector<Cube> gone;
    for (size_t i = 0; i <= index_.mask(); ++i) {
      const FlatIndex::Slot& slot = index_.slots()[i];
      if (slot.key != kNoKey && wanted[slot.value] == 0) gone.push_back(unpack_near(slot.key, last_));
    }
    if (!gone.empty()) index_.keep(wanted);
    return gone;
  }

  double edge_;
  FlatIndex index_;
  uint32_t insertions_ = 0;
  Cube last_{0, 0, 0};  // that the map was at: of the cubes that share a key the nearest is meant
};

}  // namespace heliograph
