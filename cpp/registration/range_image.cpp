// SPDX-License-Identifier: MIT
#include "registration/range_image.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "lie/so3.hpp"
#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 256;
constexpr double kMargin = 0.4, kMarginShare = 0.02;  // a place must be this far before or behind what was seen [m], of range

}  // namespace

RangeImage::RangeImage(std::span<const float> points, double cell)
    : columns_(static_cast<size_t>(std::max(4.0, std::round(2.0 * std::numbers::pi / cell)))),
      rows_(columns_ / 2 + 1),
      scale_(static_cast<double>(columns_) / (2.0 * std::numbers::pi)),
      occupied_(columns_ * rows_, 0),
      nearest_(columns_ * rows_, std::numeric_limits<float>::infinity()),
      farthest_(columns_ * rows_, 0.0F) {
  for (size_t k = 0; k + 2 < points.size(); k += 3) {
    const double p[3] = {static_cast<double>(points[k]), static_cast<double>(points[k + 1]), static_cast<double>(points[k + 2])};
    const double range = std::sqrt(lie::dot3(p, p));
    if (!std::isfinite(range) || range <= 0.0) continue;
    const size_t at = cell_of(p, range);
    occupied_[at] = 1;
    nearest_[at] = std::min(nearest_[at], static_cast<float>(range));
    farthest_[at] = std::max(farthest_[at], static_cast<float>(range));
  }
  widen();
}

size_t RangeImage::cell_of(const double* p, double range) const {
  const double azimuth = std::atan2(p[1], p[0]) + std::numbers::pi;
  const double elevation = std::asin(std::clamp(p[2] / range, -1.0, 1.0)) + 0.5 * std::numbers::pi;
  const size_t column = static_cast<size_t>(azimuth * scale_) % columns_;
  return column * rows_ + std::min(rows_ - 1, static_cast<size_t>(elevation * scale_));
}

// A surface seen at a grazing angle has other ranges in the next cell: what is called empty is empty all around.
void RangeImage::widen() {
  std::vector<float> low = nearest_, high = farthest_;
  for (size_t c = 0; c < columns_; ++c)
    for (size_t r = 0; r < rows_; ++r)
      for (size_t i = 0; i < 3; ++i)
        for (size_t j = r > 0 ? r - 1 : 0; j <= std::min(rows_ - 1, r + 1); ++j) {
          const size_t from = ((c + columns_ + i - 1) % columns_) * rows_ + j, to = c * rows_ + r;
          low[to] = std::min(low[to], nearest_[from]);
          high[to] = std::max(high[to], farthest_[from]);
        }
  nearest_ = std::move(low);
  farthest_ = std::move(high);
}

RangeImage::Sight RangeImage::look(const double* place) const {
  const double range = std::sqrt(lie::dot3(place, place));
  if (!(range > 0.0)) return Sight::outside;
  const size_t at = cell_of(place, range);
  if (occupied_[at] == 0) return Sight::outside;
  const double margin = std::max(kMargin, kMarginShare * range);
  if (static_cast<double>(nearest_[at]) > range + margin) return Sight::through;
  return static_cast<double>(farthest_[at]) < range - margin ? Sight::hidden : Sight::seen;
}

Sighting RangeImage::sight(const SurfaceCloud& to, const SurfaceCloud& from, size_t level, const double* T, double reach,
                           int threads) const {
  const KdTree& tree = *to.level(level).tree;
  const auto& elements = from.level(level).elements;
  const double R[9] = {T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10]};
  const auto square = static_cast<float>(reach * reach);
  const size_t chunks = (elements.size() + kChunk - 1) / kChunk;
  std::vector<Sighting> partial(chunks);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    Sighting& sums = partial[chunk];
    const auto& others = to.level(level).elements;
    uint32_t last = kNoNeighbour;
    for (size_t i = chunk * kChunk; i < std::min(elements.size(), (chunk + 1) * kChunk); ++i) {
      const float* m = elements[i].mean;
      const double x[3] = {static_cast<double>(m[0]), static_cast<double>(m[1]), static_cast<double>(m[2])};
      double p[3];
      lie::so3_rotate(R, x, p);
      for (int k = 0; k < 3; ++k) p[k] += T[4 * k + 3];
      const float q[3] = {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
      // Elements that follow one another mostly lie together: what was near the last one is often near enough to this.
      if (last == kNoNeighbour || square_distance(q, others[last].mean) > square) last = tree.nearest(q, square).index;
      const bool near = last != kNoNeighbour;
      const Sight seen = near ? Sight::seen : look(p);
      sums.near += near;
      sums.expected += near || seen == Sight::seen || seen == Sight::through;
      sums.through += seen == Sight::through;
    }
  });
  Sighting total;
  for (const Sighting& part : partial) {
    total.near += part.near;
    total.expected += part.expected;
    total.through += part.through;
  }
  return total;
}

}  // namespace heliograph
