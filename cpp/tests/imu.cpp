// SPDX-License-Identifier: MIT
#include <cmath>
#include <limits>
#include <vector>

#include "imu/motion_row.hpp"
#include "imu/preintegrate.hpp"
#include "imu/propagate.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

struct Samples {
  std::vector<int64_t> stamps;
  std::vector<double> gyro, accel;
  ImuSamples view() const { return {stamps, gyro.data(), accel.data()}; }
};

Samples constant(int count, int64_t period, const Eigen::Vector3d& gyro, const Eigen::Vector3d& accel) {
  Samples s;
  for (int k = 0; k < count; ++k) {
    s.stamps.push_back(k * period);
    for (int i = 0; i < 3; ++i) {
      s.gyro.push_back(gyro[i]);
      s.accel.push_back(accel[i]);
    }
  }
  return s;
}

NavState rest() {
  NavState x;
  x.R_odom_imu.setIdentity();
  x.p_odom.setZero();
  x.v_odom.setZero();
  x.gyro_bias.setZero();
  x.accel_bias.setZero();
  x.g_odom = {0.0, 0.0, -9.8};
  x.g_basis.setZero();
  return x;
}

const ImuModel kModel{1e-6, 1e-4, 1e-10, 1e-8, 0.1, 4.0, 0.3, 0.005, 250'000'000, 100'000'000};

void check_rest_stays() {
  const Samples s = constant(11, 10'000'000, {0, 0, 0}, {0, 0, 9.8});
  const Propagation out = propagate(rest(), s.view(), 0, 100'000'000, kModel);
  CHECK(out.stamps_ns.front() == 0 && out.stamps_ns.back() == 100'000'000);
  CHECK(out.R.size() == 9 * out.stamps_ns.size() && out.p.size() == 3 * out.stamps_ns.size());
  for (const double value : out.p) CHECK_NEAR(value, 0.0, 1e-12);
  CHECK(out.held_s == 0.0);
  CHECK(out.noise.trace() > 0.0 && out.noise.isApprox(out.noise.transpose()));
}

void check_half_turn() {
  const double w = 3.141592653589793;
  const Samples s = constant(101, 10'000'000, {0, 0, w}, {0, 0, 9.8});
  const Propagation out = propagate(rest(), s.view(), 0, 1'000'000'000, kModel);
  const double* R = out.R.data() + out.R.size() - 9;
  CHECK_NEAR(R[0], -1.0, 1e-9);
  CHECK_NEAR(R[1], 0.0, 1e-9);
}

void check_single_sample_before_and_after() {
  const Samples s = constant(1, 1, {0, 0, 1.0}, {0, 0, 9.8});
  for (const int64_t shift : {-2'000'000'000LL, 0LL, 2'000'000'000LL}) {
    const Propagation out = propagate(rest(), s.view(), shift, shift + 100'000'000, kModel);
    CHECK_NEAR(out.held_s, 0.1, 1e-9);
    // Within reach of the sample its rate is held; two seconds away the body coasts without turning.
    CHECK_NEAR(out.R[out.R.size() - 9 + 3], shift == 0 ? std::sin(0.1) : 0.0, 1e-9);
  }
}

void check_empty_interval_and_equal_stamps() {
  Samples s = constant(3, 10'000'000, {1, 2, 3}, {0, 0, 9.8});
  const Propagation nothing = propagate(rest(), s.view(), 5, 5, kModel);
  CHECK(nothing.stamps_ns.size() == 1 && nothing.transition.isIdentity() && nothing.noise.isZero());
  s.stamps[1] = s.stamps[2];  // the records forbid it, the kernel survives it
  const Propagation out = propagate(rest(), s.view(), 0, 20'000'000, kModel);
  CHECK(std::isfinite(out.p.back()));
}

void check_motion_is_that_of_propagation() {
  const Samples s = constant(11, 10'000'000, {0.3, -0.2, 1.0}, {1.0, 2.0, 9.8});
  for (const int64_t shift : {-2'000'000'000LL, 0LL, 60'000'000LL, 2'000'000'000LL}) {
    const ImuBias none{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    const Preintegrated motion = preintegrate(s.view(), shift, shift + 90'000'000, none, kModel);
    const Propagation out = propagate(rest(), s.view(), shift, shift + 90'000'000, kModel);
    const double* p = out.p.data() + out.p.size() - 3;
    CHECK_NEAR(p[2], motion.delta.p.z() - 9.8 * motion.delta.gravity_s2, 1e-12);
    CHECK_NEAR(motion.delta.held_s, out.held_s, 1e-12);
    CHECK(motion.combined.isApprox(motion.combined.transpose()) && motion.covariance.trace() > 0.0);
  }
}

// A row of zeros and one sample: what damaged data may hold must not crash.
void check_motion_factor_survives_odd_rows() {
  double X[15] = {1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0}, bias[6] = {1, 1, 1, 1, 1, 1}, row[MotionRow::kSize] = {}, sample[kSampleNumbers] = {};
  row[0] = row[4] = row[8] = 1.0;
  for (const double count : {1.0, 0.0, -1.0, 1e300, std::numeric_limits<double>::quiet_NaN()})
    for (const double range : {0.0, 1e3, std::numeric_limits<double>::infinity()}) {
      row[MotionRow::kCount] = count;
      row[MotionRow::kRange] = range;
      MotionTerm term;
      motion_far(row, sample, 1, bias, X, &term);
      CHECK_NEAR(term.r[0], 0.0, 1e-12);
    }
}

}  // namespace

void check_imu() {
  check_rest_stays();
  check_half_turn();
  check_single_sample_before_and_after();
  check_empty_interval_and_equal_stamps();
  check_motion_is_that_of_propagation();
  check_motion_factor_survives_odd_rows();
}
