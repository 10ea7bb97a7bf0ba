// SPDX-License-Identifier: MIT
// Integer cubes of space as 64-bit keys, and the hash that spreads them.
#pragma once
#include <cmath>
#include <cstdint>

namespace heliograph {

constexpr uint64_t kNoKey = ~uint64_t{0};
constexpr int kKeyBits = 20;
constexpr int64_t kKeyOffset = int64_t{1} << (kKeyBits - 1);
constexpr uint64_t kKeyMask = (uint64_t{1} << kKeyBits) - 1;

struct Cube {
  int64_t x, y, z;
};

// 4 bits of level and 3 x 20 bits of position: 262 km at 0.25 m. Cubes farther apart than that share keys, which a bounded
// map never sees; where it lies does not matter, as long as keys are read near a cube of it.
inline uint64_t pack(uint64_t level, const Cube& cube) {
  return (level << (3 * kKeyBits)) | ((static_cast<uint64_t>(cube.x + kKeyOffset) & kKeyMask) << (2 * kKeyBits)) |
         ((static_cast<uint64_t>(cube.y + kKeyOffset) & kKeyMask) << kKeyBits) |
         (static_cast<uint64_t>(cube.z + kKeyOffset) & kKeyMask);
}

// floor() of the baseline instruction set is a library call; a truncation and a comparison are not.
inline int64_t floor_index(double x) {
  const auto i = static_cast<int64_t>(x);
  return i - static_cast<int64_t>(x < static_cast<double>(i));
}

inline int64_t floor_index(float x) {
  const auto i = static_cast<int32_t>(x);
  return i - static_cast<int32_t>(x < static_cast<float>(i));
}

inline uint64_t key_level(uint64_t key) { return key >> (3 * kKeyBits); }

inline Cube unpack(uint64_t key) {
  return {static_cast<int64_t>((key >> (2 * kKeyBits)) & kKeyMask) - kKeyOffset,
          static_cast<int64_t>((key >> kKeyBits) & kKeyMask) - kKeyOffset,
          static_cast<int64_t>(key & kKeyMask) - kKeyOffset};
}

// The cube of a key that is nearest to another cube of the same level.
inline Cube unpack_near(uint64_t key, const Cube& near) {
  const auto from = [](int64_t packed, int64_t at) {
    const auto way = static_cast<int64_t>(static_cast<uint64_t>(packed - at + kKeyOffset) & kKeyMask);
    return at + way - kKeyOffset;
  };
  const Cube cube = unpack(key);
  return {from(cube.x, near.x), from(cube.y, near.y), from(cube.z, near.z)};
}

// The cube of edge `edge` that holds a place.
inline Cube cube_at(const double* p, double edge) {
  return {floor_index(p[0] / edge), floor_index(p[1] / edge), floor_index(p[2] / edge)};
}

// Finaliser of the SplitMix64 family: neighbouring cubes land far apart.
inline uint64_t mix(uint64_t key) {
  key ^= key >> 32;
  key *= 0xd6e8feb86659fd93ULL;
  key ^= key >> 32;
  key *= 0xd6e8feb86659fd93ULL;
  return key ^ (key >> 32);
}

}  // namespace heliograph
