// SPDX-License-Identifier: MIT
#include "cloud/scan_lines.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace heliograph {

namespace {

constexpr float kSameBeam = 4e-8F;           // squared chord of two directions that are one beam's [rad^2]
constexpr double kBin = 0.05 / 180.0 * std::numbers::pi;  // of the elevations' histogram [rad]
constexpr size_t kBins = 3600;
constexpr size_t kWidest = 6;                // bins that one laser's elevations may spread over
constexpr size_t kMinRows = 4, kMaxRows = 512;
constexpr size_t kSamples = 4096;            // pairs that the step between neighbours is the median of

bool usable(const float* p) {
  const float square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
  return std::isfinite(square) && square > 0.0F;
}

float range_of(const float* p) { return std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]); }

// Squared chord between the directions of two points.
float chord(const float* a, const float* b) {
  const float ra = 1.0F / range_of(a), rb = 1.0F / range_of(b);
  float sum = 0.0F;
  for (int i = 0; i < 3; ++i) {
    const float d = a[i] * ra - b[i] * rb;
    sum += d * d;
  }
  return sum;
}

// Puts one line into the order of time, of azimuth where no times tell.
void sort_line(std::span<const float> points, std::span<const int32_t> times, int32_t* begin, int32_t* end) {
  const auto time = [&](int32_t k) { return times[static_cast<size_t>(k)]; };
  const bool timed = std::any_of(begin, end, [&](int32_t k) { return time(k) != time(*begin); });
  if (timed) {
    const auto earlier = [&](int32_t a, int32_t b) { return time(a) < time(b); };
    if (!std::is_sorted(begin, end, earlier)) std::stable_sort(begin, end, earlier);
    return;
  }
  std::vector<std::pair<float, int32_t>> turned;
  turned.reserve(static_cast<size_t>(end - begin));
  for (const int32_t* k = begin; k != end; ++k) {
    const float* p = points.data() + 3 * static_cast<size_t>(*k);
    turned.emplace_back(std::atan2(p[1], p[0]), *k);
  }
  if (!std::is_sorted(turned.begin(), turned.end())) std::sort(turned.begin(), turned.end());
  std::transform(turned.begin(), turned.end(), begin, [](const auto& one) { return one.second; });
}

}  // namespace

ScanLines scan_lines(std::span<const float> points, std::span<const int32_t> offsets_ns, std::span<const uint16_t> rows) {
  const size_t count = rows.size();
  std::vector<uint32_t> at(65537, 0);
  std::vector<uint8_t> good(count);
  for (size_t k = 0; k < count; ++k) {
    good[k] = usable(points.data() + 3 * k);
    at[rows[k] + size_t{1}] += good[k];
  }
  for (size_t row = 0; row + 1 < at.size(); ++row) at[row + 1] += at[row];
  std::vector<uint32_t> next(at.begin(), at.end() - 1);
  std::vector<int32_t> sorted(at.back());
  for (size_t k = 0; k < count; ++k)
    if (good[k]) sorted[next[rows[k]]++] = static_cast<int32_t>(k);
  ScanLines out;
  out.order.reserve(sorted.size());
  out.starts.push_back(0);
  for (size_t row = 0; row + 1 < at.size(); ++row) {
    if (at[row] == at[row + 1]) continue;
    int32_t *begin = sorted.data() + at[row], *end = sorted.data() + at[row + 1];
    sort_line(points, offsets_ns, begin, end);
    const auto first = out.order.size();
    for (const int32_t* k = begin; k != end; ++k) {
      const float* p = points.data() + 3 * static_cast<size_t>(*k);
      const float* last = out.order.size() > first ? points.data() + 3 * static_cast<size_t>(out.order.back()) : nullptr;
      if (last == nullptr || chord(p, last) > kSameBeam) {
        out.order.push_back(*k);
        continue;
      }
      ++out.doubles;
      if (range_of(p) > range_of(last)) out.order.back() = *k;
    }
    out.starts.push_back(static_cast<int32_t>(out.order.size()));
  }
  return out;
}

ElevationRows elevation_rows(std::span<const float> points, double row_height) {
  const size_t count = points.size() / 3;
  std::vector<float> elevation(count, 0.0F);
  std::vector<uint32_t> histogram(kBins, 0);
  size_t seen = 0;
  const auto bin_of = [](float e) {
    const double bin = (static_cast<double>(e) + 0.5 * std::numbers::pi) / kBin;
    return std::min(static_cast<size_t>(std::max(bin, 0.0)), kBins - 1);
  };
  for (size_t k = 0; k < count; ++k) {
    const float* p = points.data() + 3 * k;
    if (!usable(p)) continue;
    elevation[k] = std::atan2(p[2], std::sqrt(p[0] * p[0] + p[1] * p[1]));
    ++histogram[bin_of(elevation[k])];
    ++seen;
  }
  // A bin with next to nothing in it is between two lasers.
  const auto floor = static_cast<uint32_t>(seen / 20000);
  std::vector<uint16_t> row_of(kBins, 0);
  size_t groups = 0, widest = 0, width = 0;
  for (size_t bin = 0; bin < kBins; ++bin) {
    if (histogram[bin] > floor) {
      if (width++ == 0) ++groups;
      widest = std::max(widest, width);
    } else {
      width = 0;
    }
    row_of[bin] = static_cast<uint16_t>(groups > 0 ? groups - 1 : 0);
  }
  ElevationRows out{std::vector<uint16_t>(count, 0), groups >= kMinRows && groups <= kMaxRows && widest <= kWidest};
  for (size_t k = 0; k < count; ++k) {
    const double up = static_cast<double>(elevation[k]) + 0.5 * std::numbers::pi;
    out.rows[k] = out.discrete ? row_of[bin_of(elevation[k])] : static_cast<uint16_t>(std::max(up, 0.0) / row_height);
  }
  return out;
}

double step_angle(std::span<const float> points, size_t stride) {
  const size_t count = points.size() / 3;
  if (stride == 0 || count <= stride) return std::numbers::pi;
  const size_t pairs = count - stride, skip = std::max<size_t>(pairs / kSamples, 1);
  std::vector<float> squares;
  squares.reserve(pairs / skip + 1);
  for (size_t k = 0; k < pairs; k += skip) {
    const float *a = points.data() + 3 * k, *b = points.data() + 3 * (k + stride);
    if (usable(a) && usable(b)) squares.push_back(chord(a, b));
  }
  if (squares.empty()) return std::numbers::pi;
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  return std::sqrt(static_cast<double>(*middle));
}

}  // namespace heliograph
