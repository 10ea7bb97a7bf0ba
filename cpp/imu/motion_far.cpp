// SPDX-License-Identifier: MIT
#include "imu/motion_row.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "imu/preintegrate.hpp"
#include "lie/se3.hpp"

namespace heliograph {

namespace {

using Eigen::Map;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Vector9 = Eigen::Matrix<double, 9, 1>;
template <int Rows, int Columns>
using RowMajor = Eigen::Matrix<double, Rows, Columns, Eigen::RowMajor>;
using Matrix3r = RowMajor<3, 3>;

static_assert(MotionRow::kSize == MotionRow::kModel + kImuModelNumbers);

// An element of SE_2(3).
struct Motion {
  Matrix3d R;
  Vector3d p, v;
};

Motion motion_of(const double* packed) {
  return {Map<const Matrix3r>(packed), Map<const Vector3d>(packed + 9), Map<const Vector3d>(packed + 12)};
}

Motion relative(const Motion& a, const Motion& b) {
  return {a.R.transpose() * b.R, a.R.transpose() * (b.p - a.p), a.R.transpose() * (b.v - a.v)};
}

// X exp(d).
Motion moved(const Motion& x, const Vector9& d) {
  const Vector3d turn = d.head<3>();
  const lie::ExpTerms e = lie::exp_terms(turn.squaredNorm());
  Matrix3r rotation, left;
  lie::quadratic3(turn.data(), e.sinc, e.versine, rotation.data());
  lie::quadratic3(turn.data(), e.versine, e.cubic, left.data());
  return {x.R * rotation, x.p + x.R * (left * d.segment<3>(3)), x.v + x.R * (left * d.tail<3>())};
}

// Log of an element and the inverse of the right Jacobian there.
struct Logarithm {
  Vector9 r;
  Matrix99 jacobian_inverse;

  explicit Logarithm(const Motion& E) {
    double element[15];
    Map<Matrix3r>(element, 3, 3) = E.R;
    Map<Vector3d>(element + 9) = E.p;
    Map<Vector3d>(element + 12) = E.v;
    const lie::RotationLog log = lie::motion_log<2>(element, r.data());
    Matrix3r J, C;
    lie::so3_right_jacobian_inverse(r.data(), log.h, J.data());
    jacobian_inverse.setZero();
    jacobian_inverse.block<3, 3>(0, 0) = J;
    for (int n = 1; n <= 2; ++n) {
      lie::unroll3_jacobian(r.data(), log, element + 6 + 3 * n, J.data(), C.data());
      jacobian_inverse.block<3, 3>(3 * n, 0) = C;
      jacobian_inverse.block<3, 3>(3 * n, 3 * n) = J;
    }
  }
};

// The right Jacobian at d by the blocks of its inverse, which the logarithm has up to a half turn; beyond, by halves:
// exp(d) = exp(d/2) exp(d/2).
Matrix99 right_jacobian(const Vector9& d) {
  const Motion step = moved({Matrix3d::Identity(), Vector3d::Zero(), Vector3d::Zero()}, d);
  if (d.head<3>().squaredNorm() > 9.0) {
    const Motion half = moved({Matrix3d::Identity(), Vector3d::Zero(), Vector3d::Zero()}, 0.5 * d);
    const Matrix99 J = right_jacobian(0.5 * d);
    return 0.5 * (J + adjoint_of_inverse(half.R, half.p, half.v) * J);
  }
  const Matrix99 inverse = Logarithm(step).jacobian_inverse;
  const Vector3d turn = d.head<3>();
  const lie::ExpTerms e = lie::exp_terms(turn.squaredNorm());
  Matrix3r J;
  lie::quadratic3(turn.data(), -e.versine, e.cubic, J.data());
  Matrix99 out = Matrix99::Zero();
  for (int n = 0; n < 9; n += 3) {
    out.block<3, 3>(n, n) = J;
    if (n > 0) out.block<3, 3>(n, 0) = -J * inverse.block<3, 3>(n, 0) * J;
  }
  return out;
}

struct Residual {
  Logarithm log;
  Matrix96 by_bias;
};

// Of the motion `seen` between the states against `expected`, which answers to the bias on its right by `by_bias`.
Residual compare(const Motion& expected, const Matrix96& by_bias, const Motion& seen) {
  const Motion E = relative(expected, seen);
  Residual out{Logarithm(E), Matrix96::Zero()};
  out.by_bias = -out.log.jacobian_inverse * (adjoint_of_inverse(E.R, E.p, E.v) * by_bias);
  return out;
}

// To first order in the change of the bias.
Residual corrected(const double* row, const Eigen::Matrix<double, 6, 1>& change, const Motion& seen) {
  const Map<const RowMajor<9, 6>> by_bias(row + MotionRow::kByBias);
  const Vector9 step = by_bias * change;
  return compare(moved(motion_of(row), step), right_jacobian(step) * by_bias, seen);
}

// Integrated anew at the bias.
Residual integrated(const double* row, const double* sampled, size_t count, const double* bias, const Motion& seen) {
  std::vector<int64_t> stamps(count);
  std::vector<double> gyro(3 * count), accel(3 * count);
  for (size_t k = 0; k < count; ++k) {
    const double* sample = sampled + kSampleNumbers * k;
    stamps[k] = static_cast<int64_t>(sample[0]);
    for (size_t i = 0; i < 3; ++i) {
      gyro[3 * k + i] = sample[1 + i];
      accel[3 * k + i] = sample[4 + i];
    }
  }
  const ImuDelta delta = preintegrate_delta({stamps, gyro.data(), accel.data()}, 0, static_cast<int64_t>(row[MotionRow::kEnd]),
                                            {Vector3d(bias), Vector3d(bias + 3)}, imu_model(row + MotionRow::kModel));
  return compare({delta.R, delta.p, delta.v}, delta.by_bias, seen);
}

// How far the first order is off at most, in shares of what is allowed, and its derivative by the bias.
struct Excess {
  double value;
  Eigen::Matrix<double, 6, 1> slope;

  Excess(const double* row, const Eigen::Matrix<double, 6, 1>& change) {
    const double by_gyro = row[MotionRow::kRange], by_both = row[MotionRow::kRange + 1];
    const double gyro = change.head<3>().norm(), accel = change.tail<3>().norm();
    value = by_gyro * gyro * gyro + by_both * gyro * accel;
    slope.setZero();
    if (gyro > 0.0) slope.head<3>() = (2.0 * by_gyro + by_both * accel / gyro) * change.head<3>();
    if (accel > 0.0) slope.tail<3>() = by_both * gyro / accel * change.tail<3>();
  }
};

// The first order inside the linear range, the exact integral outside twice of it, and a smooth passage between.
Residual at_bias(const double* row, const double* sampled, size_t count, const double* bias, const Motion& seen) {
  const Eigen::Matrix<double, 6, 1> change = Map<const Eigen::Matrix<double, 6, 1>>(bias) - Map<const Eigen::Matrix<double, 6, 1>>(row + MotionRow::kBias);
  const Excess excess(row, change);
  if (count == 0 || excess.value <= 1.0) return corrected(row, change, seen);
  Residual exact = integrated(row, sampled, count, bias, seen);
  if (excess.value >= 2.0) return exact;
  const Residual first = corrected(row, change, seen);
  const double t = excess.value - 1.0, w = t * t * (3.0 - 2.0 * t), slope = 6.0 * t * (1.0 - t);
  const Vector9 apart = exact.log.r - first.log.r;
  exact.by_bias = (first.by_bias + w * (exact.by_bias - first.by_bias) + slope * apart * excess.slope.transpose()).eval();
  exact.log.r = first.log.r + w * apart;
  exact.log.jacobian_inverse = (first.log.jacobian_inverse + w * (exact.log.jacobian_inverse - first.log.jacobian_inverse)).eval();
  return exact;
}

// How many of the kept samples are used, whatever a damaged row says.
size_t used(const double* row, size_t samples) {
  const double count = row[MotionRow::kCount];
  return count >= 1.0 ? static_cast<size_t>(std::min(count, static_cast<double>(samples))) : 0;
}

}  // namespace

void motion_far(const double* row, const double* sampled, size_t samples, const double* bias, const double* seen, MotionTerm* out) {
  const Residual found = at_bias(row, sampled, used(row, samples), bias, motion_of(seen));
  Map<Vector9>(out->r) = found.log.r;
  Map<Matrix3r>(out->J) = found.log.jacobian_inverse.topLeftCorner<3, 3>();
  for (int n = 0; n < 2; ++n) Map<Matrix3r>(out->C[n]) = found.log.jacobian_inverse.block<3, 3>(3 + 3 * n, 0);
  Map<RowMajor<9, 6>>(out->by_bias) = found.by_bias;
}

}  // namespace heliograph
