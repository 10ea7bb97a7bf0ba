// SPDX-License-Identifier: MIT
#include "maps/sights.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace heliograph {

namespace {

constexpr int kSide = 192;        // bins along a side of the unfolded octahedron: about a degree each
constexpr float kLow = 0.3F;      // a place lower than this below the sensor may be ground [m]
constexpr float kSlack = 1.5F;    // times the way that a ray stays within the radius of a plane
constexpr float kMisread = 0.02F;  // of the distance: ranges and poses are no better

// The sphere as a square, by arithmetic alone (octahedral map: Q. Meyer et al., On floating-point normal vectors, 2010).
std::array<int, 2> bin(float x, float y, float z) {
  const float sum = std::abs(x) + std::abs(y) + std::abs(z);
  if (!(sum > 0.0F)) return {0, 0};
  float u = x / sum, v = y / sum;
  if (z < 0.0F) {
    const float w = u;
    u = (1.0F - std::abs(v)) * (w < 0.0F ? -1.0F : 1.0F);
    v = (1.0F - std::abs(w)) * (v < 0.0F ? -1.0F : 1.0F);
  }
  const auto at = [](float t) { return std::clamp(static_cast<int>((t + 1.0F) * 0.5F * kSide), 0, kSide - 1); };
  return {at(u), at(v)};
}

// Rays by the bin of their direction.
class Rays {
 public:
  explicit Rays(std::span<const float> ends) : begin_(kSide * kSide + 1), ends_(ends.size()) {
    const size_t count = ends.size() / 3;
    std::vector<uint32_t> bins(count);
    for (size_t k = 0; k < count; ++k) {
      const auto [u, v] = bin(ends[3 * k], ends[3 * k + 1], ends[3 * k + 2]);
      bins[k] = static_cast<uint32_t>(u * kSide + v);
      ++begin_[bins[k] + 1];
    }
    for (size_t b = 0; b + 1 < begin_.size(); ++b) begin_[b + 1] += begin_[b];
    std::vector<uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (size_t k = 0; k < count; ++k) {
      const size_t to = next[bins[k]]++;
      std::copy_n(ends.data() + 3 * k, 3, ends_.data() + 3 * to);
    }
  }

  // Calls see(end) for the rays in and about the bin of a direction until it returns false.
  template <typename See>
  void about(const float* p, See&& see) const {
    const auto [u, v] = bin(p[0], p[1], p[2]);
    for (int a = std::max(u - 1, 0); a <= std::min(u + 1, kSide - 1); ++a) {
      const auto row = static_cast<size_t>(a * kSide);
      const size_t from = row + static_cast<size_t>(std::max(v - 1, 0)), to = row + static_cast<size_t>(std::min(v + 1, kSide - 1));
      for (uint32_t k = begin_[from]; k < begin_[to + 1]; ++k)
        if (!see(ends_.data() + size_t{3} * k)) return;
    }
  }

 private:
  std::vector<uint32_t> begin_;
  std::vector<float> ends_;
};

float dot(const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Whether the ray to `end` passes within the square of a radius of `p`, short of its end.
bool passes(const float* p, const float* end, float square) {
  const float along = dot(p, end), length = dot(end, end);
  return along > 0.0F && along < length && dot(p, p) - along * along / length <= square;
}

// How far a ray must go on behind a place, so that nothing that stands there can have ended it; infinite where it cannot
// be told.
float needed(const float* p, float distance, const float* normal, const SightSettings& s) {
  const float least = std::max(s.margin, kMisread * distance);
  if (normal != nullptr && dot(normal, normal) > 0.0F) {
    const float sine = std::abs(dot(normal, p)) / distance;
    return sine < s.grazing ? std::numeric_limits<float>::infinity() : std::max(least, kSlack * s.radius / sine);
  }
  return p[2] > -kLow ? least : std::max(least, kSlack * s.radius * distance / -p[2]);
}

}  // namespace

void count_seen_through(std::span<const float> places, std::span<const float> normals, const Sight& sight,
                        const SightSettings& settings, std::span<uint16_t> votes) {
  if (places.size() != 3 * votes.size() || (!normals.empty() && normals.size() != places.size()))
    throw std::invalid_argument("places, normals and votes need one row a place");
  const Rays rays(sight.ends);
  const float square = settings.radius * settings.radius, least = 4.0F * square;
  for (size_t k = 0; k < votes.size(); ++k) {
    const float* p = places.data() + 3 * k;
    const float distance2 = dot(p, p);
    if (!(distance2 <= settings.reach * settings.reach) || distance2 < least) continue;
    const float distance = std::sqrt(distance2);
    const float behind = needed(p, distance, normals.empty() ? nullptr : normals.data() + 3 * k, settings);
    if (!std::isfinite(behind)) continue;
    const float from[3] = {p[0] - sight.start[0], p[1] - sight.start[1], p[2] - sight.start[2]};
    bool through = false, there = false;
    rays.about(p, [&](const float* end) {
      const float apart[3] = {end[0] - p[0], end[1] - p[1], end[2] - p[2]};
      if (dot(apart, apart) <= least) {
        there = true;
        return false;
      }
      if (through || dot(end, end) < (distance + behind) * (distance + behind)) return true;
      const float late[3] = {end[0] - sight.start[0], end[1] - sight.start[1], end[2] - sight.start[2]};
      through = passes(p, end, square) && passes(from, late, square);
      return true;
    });
    if (through && !there && votes[k] < std::numeric_limits<uint16_t>::max()) ++votes[k];
  }
}

}  // namespace heliograph
