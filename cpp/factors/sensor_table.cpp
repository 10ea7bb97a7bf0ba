// SPDX-License-Identifier: MIT
// The table of residuals that this room brings to the graph. Another sensor is a residual in an .inl file, a code, a shape
// and a line here.
#include "factors/sensor_codes.hpp"
#include "imu/motion_row.hpp"

namespace heliograph {

namespace {

// Xi, Xj, bias or Xi, bias_i, Xj, bias_j; then gravity as a direction or a vector, or nothing.
FactorShape shape_of_motion(const ShapeQuery& q, bool walk) {
  const size_t plain = walk ? 4 : 3, j = walk ? 2 : 1;
  if (q.arity() != plain && q.arity() != plain + 1) return {};
  const bool gravity = q.arity() == plain + 1;
  if (!q.is(0, Manifold::nav) || !q.is(j, Manifold::nav) || !q.vector(walk ? 1 : 2, 6) || (walk && !q.vector(3, 6))) return {};
  if (gravity && !q.is(plain, Manifold::s2) && !q.vector(plain, 3)) return {};
  const auto fixed = static_cast<int>(MotionRow::kSize + gravity_numbers(gravity));
  const int sampled = q.measurement == kAnySize ? 0 : q.measurement - fixed;
  return {sampled >= 0 && sampled % static_cast<int>(kSampleNumbers) == 0, walk ? 15 : 9, fixed + sampled};
}

FactorShape shape_of_lever_arm(const ShapeQuery& q) {
  const bool variable = q.arity() == 2 && q.vector(1, 3), pose = q.is(0, Manifold::se3) || q.is(0, Manifold::nav);
  return {pose && (q.arity() == 1 || variable), 3, variable ? 3 : 6};
}

FactorShape shape_of_anchored_position(const ShapeQuery& q) {
  const bool pose = q.is(0, Manifold::se3) || q.is(0, Manifold::nav), variable = q.arity() == 3 && q.vector(2, 3);
  return {(q.arity() == 2 || variable) && pose && q.is(1, Manifold::se3), 3, 6};
}

FactorShape shape_of_scaled_motion(const ShapeQuery& q) {
  if (q.arity() != 3 || !q.vector(2, 1)) return {};
  const bool plain = q.is(0, Manifold::se3) && q.is(1, Manifold::se3), extended = q.is(0, Manifold::nav) && q.is(1, Manifold::nav);
  return {plain || extended, 3, 6};
}

FactorShape shape_of_mean_force(const ShapeQuery& q) {
  const bool pose = q.is(0, Manifold::se3) || q.is(0, Manifold::nav);
  return {q.arity() == 3 && pose && q.vector(1, 3) && q.vector(2, 3), 3, 12};
}

FactorShape shape_of_velocity(const ShapeQuery& q) { return {q.arity() == 1 && q.is(0, Manifold::nav), 3, 3}; }

FactorShape shape_of_lidar_pose(const ShapeQuery& q) {
  return {q.arity() == 3 && q.is(0, Manifold::nav) && q.is(1, Manifold::se3) && q.vector(2, 2), 6, 16};
}

FactorShape shape_of_calibration_prior(const ShapeQuery& q) {
  return {q.arity() == 2 && q.is(0, Manifold::se3) && q.vector(1, 2), 8, 14};
}

constexpr ResidualKind kind_of(int32_t code, FactorShape (*shape)(const ShapeQuery&)) {
  const auto type = static_cast<FactorType>(code);
#if defined(HELIOGRAPH_HAVE_AVX2)
  return {type, shape, baseline_sensor_kernels, avx2_sensor_kernels};
#else
  return {type, shape, baseline_sensor_kernels, nullptr};
#endif
}

constexpr ResidualKind kKinds[] = {
    kind_of(kPreintegratedImu, [](const ShapeQuery& q) { return shape_of_motion(q, false); }),
    kind_of(kCombinedImu, [](const ShapeQuery& q) { return shape_of_motion(q, true); }),
    kind_of(kLeverArmPosition, shape_of_lever_arm),
    kind_of(kVelocity, shape_of_velocity),
    kind_of(kLidarPose, shape_of_lidar_pose),
    kind_of(kCalibrationPrior, shape_of_calibration_prior),
    kind_of(kAnchoredPosition, shape_of_anchored_position),
    kind_of(kScaledMotion, shape_of_scaled_motion),
    kind_of(kMeanForce, shape_of_mean_force),
};

}  // namespace

std::span<const ResidualKind> brought_residuals() { return kKinds; }

}  // namespace heliograph
