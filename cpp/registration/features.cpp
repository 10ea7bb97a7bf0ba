// SPDX-License-Identifier: MIT
#include "registration/features.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kBins = 11;
constexpr size_t kNeighbours = 80;
constexpr size_t kChunk = 128;
constexpr float kPi = 3.14159265358979F;

using Histogram = std::array<float, kFeature>;
using Vector = std::array<float, 3>;

float dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Vector minus(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

size_t bin(float share) { return std::min(kBins - 1, static_cast<size_t>(std::max(0.0F, share) * static_cast<float>(kBins))); }

struct Oriented {
  Vector at, normal;
};

std::vector<Oriented> oriented(const std::vector<SurfaceElement>& elements) {
  std::vector<Oriented> out;
  out.reserve(elements.size());
  for (const SurfaceElement& e : elements) {
    Oriented o{{e.mean[0], e.mean[1], e.mean[2]}, {e.axes[0], e.axes[1], e.axes[2]}};
    if (dot(o.at, o.normal) > 0.0F)
      for (float& x : o.normal) x = -x;
    out.push_back(o);
  }
  return out;
}

// The three angles of a pair in the frame of its first normal, as bins.
void count_pair(const Oriented& a, const Oriented& b, float distance, Histogram* h) {
  Vector d = minus(b.at, a.at);
  for (float& x : d) x /= distance;
  Vector v = cross(a.normal, d);
  const float length = std::sqrt(dot(v, v));
  if (length < 1e-6F) return;
  for (float& x : v) x /= length;
  const Vector w = cross(a.normal, v);
  const float theta = std::atan2(dot(w, b.normal), dot(a.normal, b.normal));
  (*h)[bin(0.5F * (theta / kPi + 1.0F))] += 1.0F;
  (*h)[kBins + bin(0.5F * (dot(v, b.normal) + 1.0F))] += 1.0F;
  (*h)[2 * kBins + bin(0.5F * (dot(a.normal, d) + 1.0F))] += 1.0F;
}

void normalise(float* h) {
  for (size_t part = 0; part < 3; ++part) {
    float* some = h + part * kBins;
    const float total = std::accumulate(some, some + kBins, 0.0F);
    if (total > 0.0F)
      for (size_t i = 0; i < kBins; ++i) some[i] *= 100.0F / total;
  }
}

using Bits = std::vector<uint64_t>;

size_t common(const uint64_t* a, const uint64_t* b, size_t words) {
  size_t total = 0;
  for (size_t i = 0; i < words; ++i) total += static_cast<size_t>(std::popcount(a[i] & b[i]));
  return total;
}

bool consistent(const PlacePair& a, const PlacePair& b, float tolerance, float max_angle) {
  const Vector dp = minus(a.p, b.p), dq = minus(a.q, b.q);
  const float p = std::sqrt(dot(dp, dp)), q = std::sqrt(dot(dq, dq));
  // Two pairs of one place say nothing of a rotation.
  if (std::abs(p - q) > tolerance || p < 2.0F * tolerance || q < 2.0F * tolerance) return false;
  const float c = std::clamp(dot(a.normal_p, b.normal_p), -1.0F, 1.0F), d = std::clamp(dot(a.normal_q, b.normal_q), -1.0F, 1.0F);
  return std::abs(std::acos(c) - std::acos(d)) <= max_angle;
}

// The pairs consistent with `seed`, those with the most common partners first, kept while they agree with all kept.
std::vector<uint32_t> grow(const Bits& bits, size_t words, size_t count, uint32_t seed) {
  const uint64_t* own = bits.data() + seed * words;
  std::vector<std::pair<size_t, uint32_t>> candidates;
  for (uint32_t j = 0; j < count; ++j)
    if ((own[j / 64] >> (j % 64)) & 1U) candidates.emplace_back(common(own, bits.data() + j * words, words), j);
  std::sort(candidates.begin(), candidates.end(), [](const auto& a, const auto& b) {
    return a.first > b.first || (a.first == b.first && a.second < b.second);
  });
  std::vector<uint64_t> open(own, own + words);
  std::vector<uint32_t> kept{seed};
  for (const auto& [shared, j] : candidates) {
    if (!((open[j / 64] >> (j % 64)) & 1U)) continue;
    kept.push_back(j);
    for (size_t i = 0; i < words; ++i) open[i] &= bits[j * words + i];
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

}  // namespace

std::vector<float> point_features(SurfaceCloud& cloud, size_t level, double radius, int threads) {
  const std::vector<Oriented> elements = oriented(cloud.level(level).elements);
  const KdTree& tree = cloud.tree(level);
  const size_t count = elements.size(), chunks = (count + kChunk - 1) / kChunk;
  const auto square = static_cast<float>(radius * radius);
  std::vector<Histogram> simple(count, Histogram{});
  std::vector<std::vector<Neighbour>> near(count);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    std::vector<Neighbour> found(kNeighbours);
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i) {
      const size_t some = tree.nearest(elements[i].at.data(), kNeighbours, square, found.data());
      for (size_t k = 0; k < some; ++k) {
        if (found[k].square <= 0.0F) continue;
        near[i].push_back(found[k]);
        count_pair(elements[i], elements[found[k].index], std::sqrt(found[k].square), &simple[i]);
      }
      normalise(simple[i].data());
    }
  });
  std::vector<float> out(kFeature * count, 0.0F);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i) {
      float* h = out.data() + kFeature * i;
      for (const Neighbour& n : near[i]) {
        const float weight = 1.0F / std::sqrt(n.square);
        for (size_t k = 0; k < kFeature; ++k) h[k] += weight * simple[n.index][k];
      }
      normalise(h);
      for (size_t k = 0; k < kFeature; ++k) h[k] += simple[i][k];
      normalise(h);
    }
  });
  return out;
}

std::vector<int32_t> nearest_features(std::span<const float> a, std::span<const float> b, size_t count, int threads) {
  const size_t n = a.size() / kFeature, m = b.size() / kFeature;
  std::vector<int32_t> out(n * count, -1);
  parallel_chunks((n + kChunk - 1) / kChunk, threads, [&](size_t chunk) {
    std::vector<std::pair<float, int32_t>> order(m);
    for (size_t i = chunk * kChunk; i < std::min(n, (chunk + 1) * kChunk); ++i) {
      const float* x = a.data() + kFeature * i;
      for (size_t j = 0; j < m; ++j) {
        const float* y = b.data() + kFeature * j;
        float part[kBins] = {};
        for (size_t k = 0; k < kBins; ++k)
          for (size_t s = 0; s < 3; ++s) {
            const float d = x[s * kBins + k] - y[s * kBins + k];
            part[k] += d * d;
          }
        order[j] = {std::accumulate(part, part + kBins, 0.0F), static_cast<int32_t>(j)};
      }
      const size_t some = std::min(count, m);
      std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(some), order.end());
      for (size_t k = 0; k < some; ++k) out[i * count + k] = order[k].second;
    }
  });
  return out;
}

std::vector<std::vector<uint32_t>> consistent_sets(std::span<const PlacePair> pairs, double tolerance, double max_angle,
                                                   size_t seeds, int threads) {
  const size_t count = pairs.size(), words = (count + 63) / 64;
  Bits bits(count * words, 0);
  std::vector<size_t> score(count, 0);
  const auto chunks = (count + kChunk - 1) / kChunk;
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i)
      for (size_t j = 0; j < count; ++j)
        if (i != j && consistent(pairs[i], pairs[j], static_cast<float>(tolerance), static_cast<float>(max_angle)))
          bits[i * words + j / 64] |= uint64_t{1} << (j % 64);
  });
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i)
      for (size_t j = 0; j < count; ++j)
        if ((bits[i * words + j / 64] >> (j % 64)) & 1U)
          score[i] += common(bits.data() + i * words, bits.data() + j * words, words);
  });
  std::vector<uint32_t> order(count);
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return score[a] > score[b] || (score[a] == score[b] && a < b); });
  std::vector<std::vector<uint32_t>> sets;
  std::vector<uint8_t> used(count, 0);  // a pair of a set that was found would only find it again
  for (size_t k = 0; k < count && sets.size() < seeds; ++k) {
    if (used[order[k]]) continue;
    std::vector<uint32_t> set = grow(bits, words, count, order[k]);
    for (const uint32_t member : set) used[member] = 1;
    if (set.size() >= 3) sets.push_back(std::move(set));
  }
  std::stable_sort(sets.begin(), sets.end(), [](const auto& a, const auto& b) { return a.size() > b.size(); });
  return sets;
}

}  // namespace heliograph
