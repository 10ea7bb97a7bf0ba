// SPDX-License-Identifier: MIT
#include "cloud/deskew.hpp"

#include <algorithm>
#include <cmath>

#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 4096;
constexpr size_t kBins = 1024;

// Motion between two neighbouring poses, single precision: everything is relative to a pose inside the same sweep.
struct Segment {
  float R[9];      // at the segment's start
  float phi[3];    // rotation vector to the segment's end, body frame at its start
  float p[3];      // at the start
  float dp[3];     // to the end
  float angle2;    // |phi|^2
  double start;    // [ns]
  double inverse;  // 1 / length [1/ns]; 0 where the pose is held
};

// Log of R_a^T R_b.
void relative_rotation_vector(const double* Ra, const double* Rb, float* phi) {
  double M[9];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      double sum = 0.0;
      for (int k = 0; k < 3; ++k) sum += Ra[3 * k + i] * Rb[3 * k + j];
      M[3 * i + j] = sum;
    }
  const double v[3] = {M[7] - M[5], M[2] - M[6], M[3] - M[1]};
  const double sine = 0.5 * std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  const double angle = std::atan2(sine, 0.5 * (M[0] + M[4] + M[8] - 1.0));
  const double scale = sine > 1e-9 ? 0.5 * angle / sine : 0.5;
  for (int i = 0; i < 3; ++i) phi[i] = static_cast<float>(scale * v[i]);
}

std::vector<Segment> make_segments(const SweepPath& path) {
  const size_t count = path.times_ns.size();
  std::vector<Segment> segments(std::max<size_t>(count, 2) - 1);
  for (size_t k = 0; k < segments.size(); ++k) {
    Segment& s = segments[k];
    const size_t next = std::min(k + 1, count - 1);
    for (int i = 0; i < 9; ++i) s.R[i] = static_cast<float>(path.R_ref_body[9 * k + i]);
    for (int i = 0; i < 3; ++i) {
      s.p[i] = static_cast<float>(path.p_ref_body[3 * k + i]);
      s.dp[i] = static_cast<float>(path.p_ref_body[3 * next + i] - path.p_ref_body[3 * k + i]);
    }
    relative_rotation_vector(path.R_ref_body + 9 * k, path.R_ref_body + 9 * next, s.phi);
    s.angle2 = s.phi[0] * s.phi[0] + s.phi[1] * s.phi[1] + s.phi[2] * s.phi[2];
    s.start = static_cast<double>(path.times_ns[k]);
    const auto length = static_cast<double>(path.times_ns[next] - path.times_ns[k]);
    s.inverse = length > 0.0 ? 1.0 / length : 0.0;
  }
  return segments;
}

// Finds a time's segment: a table of bins gives a first guess that is never too late, a short walk the rest.
class SegmentIndex {
 public:
  explicit SegmentIndex(const std::vector<Segment>& segments) : segments_(segments), first_(kBins) {
    start_ = segments.front().start;
    const double span = segments.back().start - start_;
    scale_ = span > 0.0 ? static_cast<double>(kBins - 1) / span : 0.0;
    size_t k = 0;
    for (size_t bin = 0; bin < kBins; ++bin) {
      const double time = scale_ > 0.0 ? start_ + static_cast<double>(bin) / scale_ : start_;
      while (k + 1 < segments.size() && segments[k + 1].start <= time) ++k;
      first_[bin] = static_cast<uint32_t>(k);
    }
  }

  const Segment& at(double time) const {
    const double bin = std::clamp((time - start_) * scale_, 0.0, static_cast<double>(kBins - 1));
    size_t k = first_[static_cast<size_t>(bin)];
    if (k > 0 && segments_[k].start > time) --k;
    while (k + 1 < segments_.size() && segments_[k + 1].start <= time) ++k;
    return segments_[k];
  }

 private:
  const std::vector<Segment>& segments_;
  std::vector<uint32_t> first_;
  double start_ = 0.0, scale_ = 0.0;
};

// p_ref = R exp(s phi) x + p + s dp
inline void move(const Segment& g, double time, const float* x, float* out) {
  const float s = std::clamp(static_cast<float>((time - g.start) * g.inverse), 0.0F, 1.0F);
  const float a2 = g.angle2 * s * s;
  float sine, cosine;
  if (a2 < 0.04F) {
    sine = 1.0F - a2 * (1.0F / 6.0F - a2 * (1.0F / 120.0F));
    cosine = 0.5F - a2 * (1.0F / 24.0F - a2 * (1.0F / 720.0F));
  } else {
    const float a = std::sqrt(a2);
    sine = std::sin(a) / a;
    cosine = (1.0F - std::cos(a)) / a2;
  }
  const float u = s * g.phi[0], v = s * g.phi[1], w = s * g.phi[2];
  const float c0 = v * x[2] - w * x[1], c1 = w * x[0] - u * x[2], c2 = u * x[1] - v * x[0];
  const float y0 = x[0] + sine * c0 + cosine * (v * c2 - w * c1);
  const float y1 = x[1] + sine * c1 + cosine * (w * c0 - u * c2);
  const float y2 = x[2] + sine * c2 + cosine * (u * c1 - v * c0);
  for (int i = 0; i < 3; ++i)
    out[i] = g.R[3 * i] * y0 + g.R[3 * i + 1] * y1 + g.R[3 * i + 2] * y2 + g.p[i] + s * g.dp[i];
}

}  // namespace

std::vector<float> deskew(std::span<const float> points, std::span<const int32_t> offsets_ns, const SweepPath& path,
                          const double* T_body_lidar, int threads) {
  const size_t count = offsets_ns.size();
  std::vector<float> out(points.size());
  if (count == 0) return out;
  const std::vector<Segment> segments = make_segments(path);
  const SegmentIndex index(segments);
  float R[9], t[3];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) R[3 * i + j] = static_cast<float>(T_body_lidar[4 * i + j]);
    t[i] = static_cast<float>(T_body_lidar[4 * i + 3]);
  }
  parallel_chunks((count + kChunk - 1) / kChunk, threads, [&](size_t chunk) {
    const size_t end = std::min(count, (chunk + 1) * kChunk);
    for (size_t k = chunk * kChunk; k < end; ++k) {
      const float* q = points.data() + 3 * k;
      float x[3];
      for (int i = 0; i < 3; ++i) x[i] = R[3 * i] * q[0] + R[3 * i + 1] * q[1] + R[3 * i + 2] * q[2] + t[i];
      const auto time = static_cast<double>(offsets_ns[k]);
      move(index.at(time), time, x, out.data() + 3 * k);
    }
  });
  return out;
}

}  // namespace heliograph
