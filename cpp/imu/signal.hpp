// SPDX-License-Identifier: MIT
// Inertial samples as a continuous signal, walked through in the steps of the midpoint rule. Propagation and
// preintegration both take their steps here, so that they integrate the same thing.
#pragma once
#include <Eigen/Dense>
#include <algorithm>
#include <cstdint>
#include <span>

#include "lie/so3.hpp"

namespace heliograph {

struct ImuSamples {
  std::span<const int64_t> stamps_ns;
  const double* gyro;   // (M, 3)
  const double* accel;  // (M, 3)
};

// Densities squared: white noise and random walks, and what is added where samples are held or bridged over a gap.
struct ImuModel {
  double gyro_var;
  double accel_var;
  double gyro_walk_var;
  double accel_walk_var;
  double held_gyro_var;
  double held_accel_var;
  double curvature;    // share of the change between two samples that linear interpolation is taken to miss
  double max_step;     // [s]
  int64_t max_gap_ns;  // a longer distance between samples counts as held
  int64_t hold_ns;     // farther than this from any sample nothing is held: the body coasts
};

constexpr size_t kImuModelNumbers = 10;

inline ImuModel imu_model(const double* k) {
  const auto whole = [](double ns) { return static_cast<int64_t>(std::min(ns, 1e18)); };
  return {k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], whole(k[8]), whole(k[9])};
}

struct ImuStep {
  int64_t to_ns;            // its end
  double dt;                // [s]
  Eigen::Vector3d gyro;     // readings in its middle
  Eigen::Vector3d accel;
  double gyro_var;          // white noise there, densities squared
  double accel_var;
  bool held;                // no pair of samples covers it
  bool coasting;            // too far from any sample: no rotation, no acceleration
};

// Walks from t0 to t1: a step ends at every sample, and longer ones are divided evenly. Between two samples the signal is
// linear; outside them, and in gaps, the nearest one is held. At least one sample.
class ImuWalk {
 public:
  ImuWalk(const ImuSamples& samples, const ImuModel& model, int64_t t0_ns, int64_t t1_ns)
      : samples_(samples), model_(model), end_(t1_ns), step_ns_(std::max<int64_t>(1, static_cast<int64_t>(model.max_step * 1e9))), from_(t0_ns), knot_(t0_ns) {
    const auto& s = samples.stamps_ns;
    next_ = static_cast<size_t>(std::upper_bound(s.begin(), s.end(), t0_ns) - s.begin());
  }

  // The next step, or false at the end.
  bool next(ImuStep& step) {
    if (part_ == parts_) {
      if (from_ >= end_) return false;
      open_span();
    }
    ++part_;
    const int64_t to = knot_ + span_ * part_ / parts_, middle = from_ + (to - from_) / 2;
    step.to_ns = to;
    step.dt = 1e-9 * static_cast<double>(to - from_);
    step.gyro_var = gyro_var_;
    step.accel_var = accel_var_;
    step.held = held_;
    read(middle, step);
    from_ = to;
    if (part_ == parts_) knot_ = to;
    return true;
  }

 private:
  // From the last knot, a sample or the start, to the next, a sample or the end: all that is the same in between. A stretch that
  // is coasted through is one step, whatever its length: neither turned nor pushed, all sums over it are exact. So what a gap
  // costs does not grow with what the stamps say.
  void open_span() {
    const auto& s = samples_.stamps_ns;
    while (next_ < s.size() && s[next_] <= knot_) ++next_;
    int64_t until = next_ < s.size() ? std::min(s[next_], end_) : end_;
    gyro_var_ = model_.gyro_var;
    accel_var_ = model_.accel_var;
    held_ = next_ == 0 || next_ == s.size();
    if (!held_) {
      const int64_t period = s[next_] - s[next_ - 1];
      held_ = period > model_.max_gap_ns;
      // What lies between two samples is unknown: linear interpolation misses a share of the change from one to the next.
      const double missed = model_.curvature * model_.curvature * (1e-9 * static_cast<double>(period)) / 3.0;
      gyro_var_ += missed * (gyro(next_) - gyro(next_ - 1)).squaredNorm();
      accel_var_ += missed * (accel(next_) - accel(next_ - 1)).squaredNorm();
    }
    coasting_ = false;
    if (held_) {
      gyro_var_ += model_.held_gyro_var;
      accel_var_ += model_.held_accel_var;
      const int64_t left = next_ > 0 ? s[next_ - 1] + model_.hold_ns : INT64_MIN;
      const int64_t right = next_ < s.size() ? s[next_] - model_.hold_ns : INT64_MAX;
      coasting_ = left <= knot_ && knot_ < right;
      if (coasting_) until = std::min(until, right);
      if (knot_ < left && left < right) until = std::min(until, left);
    }
    span_ = until - knot_;
    // The tolerance keeps a nominal period with jitter from being split in two.
    parts_ = coasting_ ? 1 : std::max<int64_t>(1, (span_ + step_ns_ - 1 - step_ns_ / 4) / step_ns_);
    part_ = 0;
  }

  void read(int64_t t, ImuStep& step) const {
    const auto& s = samples_.stamps_ns;
    const int64_t before = next_ == 0 ? INT64_MAX : t - s[next_ - 1];
    const int64_t until = next_ == s.size() ? INT64_MAX : s[next_] - t;
    step.coasting = coasting_;
    if (held_) {
      const size_t nearest = before <= until ? next_ - 1 : next_;
      step.gyro = gyro(nearest);
      step.accel = accel(nearest);
      return;
    }
    const double share = static_cast<double>(before) / static_cast<double>(before + until);
    step.gyro = gyro(next_ - 1) + share * (gyro(next_) - gyro(next_ - 1));
    step.accel = accel(next_ - 1) + share * (accel(next_) - accel(next_ - 1));
  }

  Eigen::Map<const Eigen::Vector3d> gyro(size_t i) const { return Eigen::Map<const Eigen::Vector3d>(samples_.gyro + 3 * i); }
  Eigen::Map<const Eigen::Vector3d> accel(size_t i) const { return Eigen::Map<const Eigen::Vector3d>(samples_.accel + 3 * i); }

  const ImuSamples samples_;
  const ImuModel model_;
  const int64_t end_, step_ns_;
  int64_t from_, knot_, span_ = 0, parts_ = 0, part_ = 0;
  size_t next_ = 0;  // the first sample after the last knot
  double gyro_var_ = 0.0, accel_var_ = 0.0;
  bool held_ = false, coasting_ = false;
};

// Of a step's small angle five terms of the series are exact to the last bit.
inline lie::ExpTerms step_terms(double s) {
  if (s > 0.01) return lie::exp_terms(s);
  const auto sum = [s](const double* c) { return c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4]))); };
  return {sum(lie::kSinc.c), sum(lie::kVersine.c), sum(lie::kCubic.c)};
}

// One step of rotation by the rate: over half of it, over all of it, and the right Jacobians of both.
struct StepTurn {
  Eigen::Matrix3d half, whole, half_jacobian, whole_jacobian;

  StepTurn(const Eigen::Vector3d& rate, double dt) {
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const Eigen::Vector3d turn = 0.5 * dt * rate, twice = dt * rate;
    const lie::ExpTerms e = step_terms(turn.squaredNorm());
    // Of twice the angle, by the addition theorems: nothing cancels.
    const double sinc = e.sinc * (1.0 - turn.squaredNorm() * e.versine), versine = 0.5 * e.sinc * e.sinc;
    const double cubic = 0.25 * (e.cubic + e.sinc * e.versine);
    RowMajor m;
    lie::quadratic3(turn.data(), e.sinc, e.versine, m.data());
    half = m;
    lie::quadratic3(turn.data(), -e.versine, e.cubic, m.data());
    half_jacobian = m;
    lie::quadratic3(twice.data(), sinc, versine, m.data());
    whole = m;
    lie::quadratic3(twice.data(), -versine, cubic, m.data());
    whole_jacobian = m;
  }
};

inline Eigen::Matrix3d hat(const Eigen::Vector3d& w) {
  Eigen::Matrix3d m;
  m << 0.0, -w.z(), w.y(), w.z(), 0.0, -w.x(), -w.y(), w.x(), 0.0;
  return m;
}

}  // namespace heliograph
