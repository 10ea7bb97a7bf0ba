// SPDX-License-Identifier: MIT
// Compiled once for each instruction set, as graph/factors/factors.inl is: finds the residual of a sensor's group.
#include "factors/antenna.inl"
#include "factors/lidar_pose.inl"
#include "factors/mean_force.inl"
#include "factors/preintegrated.inl"

namespace heliograph {
namespace {

template <bool kWalk, class Action>
static bool visit_motion(const Action& action) {
  const FactorView& v = action.view;
  if (v.arity == (kWalk ? 4 : 3)) return action.template with<PreintegratedMotion<kWalk, 0>>();
  const bool direction = v.manifold[v.arity - 1] == Manifold::s2;
  return direction ? action.template with<PreintegratedMotion<kWalk, 2>>() : action.template with<PreintegratedMotion<kWalk, 3>>();
}

template <class P, class Action>
static bool visit_lever_arm(const Action& action) {
  return action.view.arity == 2 ? action.template with<LeverArmPosition<P, true>>()
                                : action.template with<LeverArmPosition<P, false>>();
}

template <class P, class Action>
static bool visit_anchored(const Action& action) {
  return action.view.arity == 3 ? action.template with<AnchoredPosition<P, true>>()
                                : action.template with<AnchoredPosition<P, false>>();
}

struct Sensors {
  template <class Action>
  static bool visit(const Action& action) {
    switch (static_cast<int32_t>(action.view.type)) {
      case kPreintegratedImu: return visit_motion<false>(action);
      case kCombinedImu: return visit_motion<true>(action);
      case kLeverArmPosition:
        return action.view.manifold[0] == Manifold::se3 ? visit_lever_arm<PoseSe3>(action) : visit_lever_arm<PoseNav>(action);
      case kVelocity: return action.template with<Velocity>();
      case kLidarPose: return action.template with<LidarPose>();
      case kCalibrationPrior: return action.template with<CalibrationPrior>();
      case kAnchoredPosition:
        return action.view.manifold[0] == Manifold::se3 ? visit_anchored<PoseSe3>(action) : visit_anchored<PoseNav>(action);
      case kScaledMotion:
        return action.view.manifold[0] == Manifold::se3 ? action.template with<ScaledMotion<PoseSe3>>()
                                                        : action.template with<ScaledMotion<PoseNav>>();
      case kMeanForce:
        return action.view.manifold[0] == Manifold::se3 ? action.template with<MeanForce<PoseSe3>>()
                                                        : action.template with<MeanForce<PoseNav>>();
      default: return false;
    }
  }
};

}  // namespace
}  // namespace heliograph
