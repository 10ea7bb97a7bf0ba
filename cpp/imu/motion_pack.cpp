// SPDX-License-Identifier: MIT
#include "imu/motion_pack.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "lie/so3.hpp"

namespace heliograph {

namespace {

constexpr size_t kFewest = 16;  // rows of samples

struct Range {
  size_t first, last;
};

// The samples that matter to an interval: from the one before it to one after it. There is at least one sample.
Range range_of(std::span<const int64_t> stamps, int64_t start, int64_t end) {
  const auto after = static_cast<size_t>(std::upper_bound(stamps.begin(), stamps.end(), start) - stamps.begin());
  const auto until = static_cast<size_t>(std::lower_bound(stamps.begin(), stamps.end(), end) - stamps.begin());
  const size_t first = after > 0 ? after - 1 : 0;
  return {first, std::max(std::min(until, stamps.size() - 1) + 1, first + 1)};
}

double mean_force(const ImuSamples& samples, const Range& range) {
  double sum = 0.0;
  for (size_t i = range.first; i < range.last; ++i) {
    const double* a = samples.accel + 3 * i;
    sum += std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
  }
  return sum / static_cast<double>(range.last - range.first);
}

void put_samples(const ImuSamples& samples, const Range& range, int64_t start, size_t rows, double* out) {
  for (size_t i = range.first; i < range.last; ++i) {
    double* row = out + kSampleNumbers * (i - range.first);
    row[0] = static_cast<double>(samples.stamps_ns[i] - start);  // exact in doubles within an interval
    std::copy_n(samples.gyro + 3 * i, 3, row + 1);
    std::copy_n(samples.accel + 3 * i, 3, row + 4);
  }
  std::fill(out + kSampleNumbers * (range.last - range.first), out + kSampleNumbers * rows, 0.0);
}

}  // namespace

size_t sample_rows(const ImuSamples& samples, const MotionArrays& motions) {
  size_t most = kFewest;
  for (size_t k = 0; k < motions.count; ++k) {
    const Range range = range_of(samples.stamps_ns, motions.start_ns[k], motions.end_ns[k]);
    most = std::max(most, range.last - range.first);
  }
  return std::bit_ceil(most);
}

void linear_range(const double* covariance, double duration, double force, double share, double* range) {
  double allowed[3];
  for (size_t part = 0; part < 3; ++part) {
    double least = covariance[30 * part];
    for (size_t i = 1; i < 3; ++i) least = std::min(least, covariance[10 * (3 * part + i)]);
    allowed[part] = std::max(share * std::sqrt(least), 1e-300);
  }
  const double T = duration, T2 = T * T;
  const double turn = T2 / 2.0 / allowed[0], velocity = force * T2 * T / 6.0 / allowed[2], position = force * T2 * T2 / 24.0 / allowed[1];
  range[0] = std::min(std::max({turn, velocity, position}), 1e300);
  range[1] = std::min(std::max(T2 / 2.0 / allowed[2], T2 * T / 6.0 / allowed[1]), 1e300);
}

bool pack_motions(const ImuSamples& samples, const MotionArrays& m, std::span<const double> gravity, double share, size_t rows,
                  double* out) {
  const size_t width = MotionRow::kSize + gravity.size() + kSampleNumbers * rows;
  for (size_t k = 0; k < m.count; ++k) {
    double* row = out + width * k;
    const Range range = range_of(samples.stamps_ns, m.start_ns[k], m.end_ns[k]);
    std::copy_n(m.R + 9 * k, 9, row);
    std::copy_n(m.p + 3 * k, 3, row + 9);
    std::copy_n(m.v + 3 * k, 3, row + 12);
    for (size_t i = 0; i < 3; ++i) row[MotionRow::kTimes + i] = m.times[i][k];
    std::copy_n(m.gyro_bias + 3 * k, 3, row + MotionRow::kBias);
    std::copy_n(m.accel_bias + 3 * k, 3, row + MotionRow::kBias + 3);
    std::copy_n(m.by_bias + 54 * k, 54, row + MotionRow::kByBias);
    linear_range(m.covariance + 81 * k, m.times[0][k], mean_force(samples, range), share, row + MotionRow::kRange);
    row[MotionRow::kCount] = static_cast<double>(range.last - range.first);
    row[MotionRow::kEnd] = static_cast<double>(m.end_ns[k] - m.start_ns[k]);
    std::copy_n(m.model, kImuModelNumbers, row + MotionRow::kModel);
    std::copy(gravity.begin(), gravity.end(), row + MotionRow::kSize);
    if (rows > 0) put_samples(samples, range, m.start_ns[k], rows, row + MotionRow::kSize + gravity.size());
  }
  return std::all_of(out, out + width * m.count, [](double x) { return std::isfinite(x); });
}

void predict_state(const double* R, const double* p, const double* v, const double* const* times, const double* by_bias,
                   const double* change, const double* X, const double* gravity, double* out) {
  double step[9] = {}, turn[9], left[9], delta_R[9], world_R[9], start_R[9];
  for (size_t i = 0; i < 9; ++i)
    for (size_t c = 0; c < 6; ++c) step[i] += by_bias[6 * i + c] * change[c];
  const lie::ExpTerms e = lie::exp_terms(lie::dot3(step, step));
  lie::quadratic3(step, e.sinc, e.versine, turn);
  lie::quadratic3(step, e.versine, e.cubic, left);
  lie::multiply3(R, turn, delta_R);
  for (size_t i = 0; i < 9; ++i) start_R[i] = X[5 * (i / 3) + i % 3];
  lie::multiply3(start_R, delta_R, world_R);
  double moved[2][3];
  for (size_t n = 0; n < 2; ++n) {
    double pushed[3], local[3];
    lie::so3_rotate(left, step + 3 + 3 * n, pushed);
    lie::so3_rotate(R, pushed, local);
    for (size_t i = 0; i < 3; ++i) local[i] += (n == 0 ? p : v)[i];
    lie::so3_rotate(start_R, local, moved[n]);
  }
  std::fill(out, out + 25, 0.0);
  out[18] = out[24] = 1.0;
  for (size_t i = 0; i < 3; ++i) {
    std::copy_n(world_R + 3 * i, 3, out + 5 * i);
    const double velocity = X[5 * i + 4];
    out[5 * i + 3] = X[5 * i + 3] + velocity * *times[0] + gravity[i] * *times[2] + moved[0][i];
    out[5 * i + 4] = velocity + gravity[i] * *times[1] + moved[1][i];
  }
}

}  // namespace heliograph
