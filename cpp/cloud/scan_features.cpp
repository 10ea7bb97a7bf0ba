// SPDX-License-Identifier: MIT
#include "cloud/scan_features.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr float kBreak = 16.0F;  // squared ratio of a step to the usual one at which a line is broken
constexpr size_t kSpare = 4;     // candidates sorted for each point asked for: neighbours of one that is taken drop out

enum Mark : uint8_t { kFree = 0, kUnfit = 1, kTaken = 2, kSilhouette = 4 };

// One line: its points in order, how far each lies from the mean of its neighbours, and what is wrong with it.
class Line {
 public:
  Line(std::span<const float> points, std::span<const int32_t> order, const ScanFeatureSettings& settings)
      : order_(order), settings_(settings), n_(order.size()), w_(static_cast<size_t>(settings.window)) {
    if (n_ < 2 * w_ + 1) return;
    xyz_.resize(3 * n_);
    range_.resize(n_);
    for (size_t k = 0; k < n_; ++k) {
      const float* p = points.data() + 3 * static_cast<size_t>(order[k]);
      std::copy(p, p + 3, xyz_.data() + 3 * k);
      range_[k] = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    }
    offset_.assign(n_, 0.0F);
    mark_.assign(n_, kFree);
    mark_breaks();
    mark_grazing();
    measure();
  }

  void pick(ScanFeatures* out) {
    if (n_ < 2 * w_ + 1) return;
    const size_t regions = std::max<size_t>((n_ + static_cast<size_t>(settings_.region) / 2) / static_cast<size_t>(settings_.region), 1);
    for (size_t r = 0; r < regions; ++r) pick_region(r * n_ / regions, (r + 1) * n_ / regions, out);
    pick_map_planes(out);
  }

 private:
  void unfit(size_t begin, size_t end) {
    for (size_t k = begin; k < std::min(end, n_); ++k) mark_[k] |= kUnfit;
  }

  // Where beams are missing, or the surface ends, a window would reach over to something else. What lies behind a nearer
  // surface may be hidden from the next place; the rim of the nearer one is an edge.
  void mark_breaks() {
    std::vector<float> steps(n_ - 1);
    for (size_t k = 0; k + 1 < n_; ++k) {
      float sum = 0.0F;
      for (size_t i = 0; i < 3; ++i) {
        const float d = xyz_[3 * k + i] / range_[k] - xyz_[3 * k + 3 + i] / range_[k + 1];
        sum += d * d;
      }
      steps[k] = sum;
    }
    std::vector<float> sorted = steps;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const float widest = kBreak * *middle, gap = static_cast<float>(settings_.gap);
    unfit(0, w_);
    unfit(n_ - w_, n_);
    for (size_t k = 0; k + 1 < n_; ++k) {
      const bool broken = steps[k] > widest;
      const float deeper = range_[k + 1] - range_[k];
      if (!broken && std::abs(deeper) <= gap) continue;
      unfit(k + 1 >= w_ ? k + 1 - w_ : 0, k + 1 + w_);
      if (!broken) mark_[deeper > 0.0F ? k : k + 1] |= kSilhouette;
    }
  }

  void mark_grazing() {
    const auto share = static_cast<float>(settings_.grazing);
    for (size_t k = 1; k + 1 < n_; ++k) {
      const float limit = share * range_[k];
      if (std::abs(range_[k - 1] - range_[k]) > limit && std::abs(range_[k + 1] - range_[k]) > limit) mark_[k] = kUnfit;
    }
  }

  // LOAM's eq. (1), of which only the part across the line counts: uneven steps along a straight one are no corner.
  void measure() {
    double sum[3] = {0.0, 0.0, 0.0};
    for (size_t k = 0; k < 2 * w_ + 1; ++k)
      for (size_t i = 0; i < 3; ++i) sum[i] += static_cast<double>(xyz_[3 * k + i]);
    const auto size = static_cast<double>(2 * w_ + 1);
    for (size_t k = w_; k + w_ < n_; ++k) {
      double d[3], t[3], along = 0.0, length = 0.0, square = 0.0;
      for (size_t i = 0; i < 3; ++i) {
        d[i] = (sum[i] - size * static_cast<double>(xyz_[3 * k + i])) / (size - 1.0);
        t[i] = static_cast<double>(xyz_[3 * (k + w_) + i]) - static_cast<double>(xyz_[3 * (k - w_) + i]);
        along += d[i] * t[i];
        length += t[i] * t[i];
        square += d[i] * d[i];
      }
      if (length > 0.0) square -= along * along / length;
      offset_[k] = static_cast<float>(std::sqrt(std::max(square, 0.0)));
      if (k + w_ + 1 < n_)
        for (size_t i = 0; i < 3; ++i)
          sum[i] += static_cast<double>(xyz_[3 * (k + w_ + 1) + i]) - static_cast<double>(xyz_[3 * (k - w_) + i]);
    }
  }

  // A rim comes before all corners: the jump beside it is the largest offset there is.
  void pick_region(size_t begin, size_t end, ScanFeatures* out) {
    std::vector<std::pair<float, size_t>> corners, flats;
    const auto noise = static_cast<float>(3.0 * settings_.noise);
    for (size_t k = begin; k < end; ++k) {
      if (mark_[k] & kSilhouette && !(mark_[k] & kTaken)) corners.emplace_back(-range_[k], k);
      if (mark_[k] != kFree) continue;
      const float curved = offset_[k] / range_[k];
      if (offset_[k] > noise && curved > static_cast<float>(settings_.edge_curvature)) corners.emplace_back(-offset_[k], k);
      else if (offset_[k] <= noise || curved < static_cast<float>(settings_.plane_curvature)) flats.emplace_back(offset_[k], k);
    }
    const auto most = static_cast<size_t>(settings_.map_edges), some = static_cast<size_t>(settings_.edges);
    size_t taken = 0;
    each_apart(corners, most, [&](size_t k) {
      if (taken++ < some) out->edges.push_back(order_[k]);
      out->map_edges.push_back(order_[k]);
    });
    each_apart(flats, static_cast<size_t>(settings_.planes), [&](size_t k) { out->planes.push_back(order_[k]); });
  }

  // Calls `use` for the first of the candidates in their order that are not beside one taken before.
  template <typename Use>
  void each_apart(std::vector<std::pair<float, size_t>>& candidates, size_t most, const Use& use) {
    const size_t sorted = std::min(candidates.size(), kSpare * most);
    std::partial_sort(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(sorted), candidates.end());
    size_t taken = 0;
    for (size_t c = 0; c < sorted && taken < most; ++c) {
      const size_t k = candidates[c].second;
      if (mark_[k] & kTaken) continue;
      ++taken;
      use(k);
      for (size_t j = k >= w_ ? k - w_ : 0; j <= std::min(k + w_, n_ - 1); ++j) mark_[j] |= kTaken;
    }
  }

  void pick_map_planes(ScanFeatures* out) const {
    const auto stride = static_cast<size_t>(settings_.map_stride);
    const auto noise = static_cast<float>(3.0 * settings_.noise), flat = static_cast<float>(settings_.plane_curvature);
    size_t waiting = stride;
    for (size_t k = w_; k + w_ < n_; ++k) {
      if (++waiting < stride || mark_[k] & (kUnfit | kSilhouette)) continue;
      if (offset_[k] > noise && offset_[k] >= flat * range_[k]) continue;
      out->map_planes.push_back(order_[k]);
      waiting = 0;
    }
  }

  std::span<const int32_t> order_;
  const ScanFeatureSettings& settings_;
  size_t n_, w_;
  std::vector<float> xyz_, range_, offset_;
  std::vector<uint8_t> mark_;
};

}  // namespace

ScanFeatures scan_features(std::span<const float> points, std::span<const int32_t> order, std::span<const int32_t> starts,
                           const ScanFeatureSettings& settings, int threads) {
  const size_t lines = starts.empty() ? 0 : starts.size() - 1;
  std::vector<ScanFeatures> found(lines);
  parallel_chunks(lines, threads, [&](size_t line) {
    const auto begin = static_cast<size_t>(starts[line]), end = static_cast<size_t>(starts[line + 1]);
    Line(points, order.subspan(begin, end - begin), settings).pick(&found[line]);
  });
  ScanFeatures out;
  for (const ScanFeatures& one : found) {
    out.edges.insert(out.edges.end(), one.edges.begin(), one.edges.end());
    out.planes.insert(out.planes.end(), one.planes.begin(), one.planes.end());
    out.map_edges.insert(out.map_edges.end(), one.map_edges.begin(), one.map_edges.end());
    out.map_planes.insert(out.map_planes.end(), one.map_planes.begin(), one.map_planes.end());
  }
  return out;
}

}  // namespace heliograph
