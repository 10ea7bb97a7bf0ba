// SPDX-License-Identifier: MIT
// Compiled once for each instruction set, in a translation unit of its own. Everything here has internal linkage and no
// library template is instantiated, so that no AVX2 code can be merged into the baseline build by the linker.
// This file finds the residual of a group and hands it to an action: linearise, cost or evaluate.
#include "graph/factors/between_blocks.inl"
#include "graph/factors/residuals_plane.inl"
#include "graph/factors/residuals_point.inl"

namespace heliograph {
namespace {

template <template <class> class Residual, class Action>
static bool visit_one_vector(const Action& action) {
  switch (action.view.dof[0]) {
    case 1: return action.template with<Residual<Fixed<1, 1>>>();
    case 2: return action.template with<Residual<Fixed<2, 2>>>();
    case 3: return action.template with<Residual<Fixed<3, 3>>>();
    default: return action.template with<Residual<Dynamic>>();
  }
}

template <template <class> class Residual, class Action>
static bool visit_two_vectors(const Action& action) {
  switch (action.view.dof[0] == action.view.dof[1] ? action.view.dof[0] : 0) {
    case 1: return action.template with<Residual<Fixed<1, 1, 1>>>();
    case 2: return action.template with<Residual<Fixed<2, 2, 2>>>();
    case 3: return action.template with<Residual<Fixed<3, 3, 3>>>();
    case 4: return action.template with<Residual<Fixed<4, 4, 4>>>();
    case 6: return action.template with<Residual<Fixed<6, 6, 6>>>();
    default: return action.template with<Residual<Dynamic>>();
  }
}

// What users write most: a residual between two variables of its own dimension.
template <class Action>
static bool visit_custom(const Action& action) {
  const FactorView& v = action.view;
  const bool square = v.arity == 2 && v.rows == v.dof[0] && v.rows == v.dof[1];
  return square ? visit_two_vectors<Custom>(action) : action.template with<Custom<Dynamic>>();
}

// The leading parts of a motion with `kVectors` vectors that are measured.
template <int kVectors, class Action>
static bool visit_prior_of_motion(const Action& action) {
  if (action.view.rows == 3) return action.template with<PriorMotion<0, kVectors>>();
  if constexpr (kVectors >= 1)
    if (action.view.rows == 6) return action.template with<PriorMotion<1, kVectors>>();
  if constexpr (kVectors >= 2)
    if (action.view.rows == 9) return action.template with<PriorMotion<2, kVectors>>();
  return false;
}

template <class Action>
static bool visit_prior(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::vector: return visit_one_vector<PriorVector>(action);
    case Manifold::so2: return action.template with<PriorSo2>();
    case Manifold::so3: return visit_prior_of_motion<0>(action);
    case Manifold::se2: return action.template with<PriorSe2>();
    case Manifold::se3: return visit_prior_of_motion<1>(action);
    case Manifold::s2: return action.template with<PriorS2>();
    case Manifold::nav: return visit_prior_of_motion<2>(action);
  }
  return false;
}

template <class Action>
static bool visit_rows(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::vector: return action.template with<RowsOf<PriorVector<Dynamic>>>();
    case Manifold::so2: return action.template with<RowsOf<PriorSo2>>();
    case Manifold::so3: return action.template with<RowsOf<PriorMotion<0, 0>>>();
    case Manifold::se2: return action.template with<RowsOf<PriorSe2>>();
    case Manifold::se3: return action.template with<RowsOf<PriorMotion<1, 1>>>();
    case Manifold::s2: return action.template with<RowsOf<PriorS2>>();
    case Manifold::nav: return action.template with<RowsOf<PriorMotion<2, 2>>>();
  }
  return false;
}

template <int kI, int kJ, class Action>
static bool visit_between_motions(const Action& action) {
  if (action.view.rows == 3) return action.template with<BetweenMotion<0, kI, kJ>>();
  if (action.view.rows == 6) return action.template with<BetweenMotion<1, kI, kJ>>();
  if constexpr (kI >= 2 && kJ >= 2)
    if (action.view.rows == 9) return action.template with<BetweenMotion<2, kI, kJ>>();
  return false;
}

template <class Action>
static bool visit_between(const Action& action) {
  const bool extended = action.view.manifold[1] == Manifold::nav;
  switch (action.view.manifold[0]) {
    case Manifold::vector: return visit_two_vectors<BetweenVector>(action);
    case Manifold::so2: return action.template with<BetweenSo2>();
    case Manifold::so3: return action.template with<BetweenMotion<0, 0, 0>>();
    case Manifold::se2: return action.template with<BetweenSe2>();
    case Manifold::se3: return extended ? visit_between_motions<1, 2>(action) : visit_between_motions<1, 1>(action);
    case Manifold::nav: return extended ? visit_between_motions<2, 2>(action) : visit_between_motions<2, 1>(action);
    case Manifold::s2: return false;  // not a group
  }
  return false;
}

template <template <class, class> class Residual, class I, class Action>
static bool visit_target(const Action& action) {
  const Manifold target = action.view.manifold[1];
  if constexpr (I::kSpace == 2) {
    if (target == Manifold::se2) return action.template with<Residual<I, PoseSe2>>();
    if (target == Manifold::vector && action.view.dof[1] == 2) return action.template with<Residual<I, Point2>>();
  } else {
    if (target == Manifold::se3) return action.template with<Residual<I, PoseSe3>>();
    if (target == Manifold::nav) return action.template with<Residual<I, PoseNav>>();
    if (target == Manifold::vector && action.view.dof[1] == 3) return action.template with<Residual<I, Point3>>();
  }
  return false;
}

template <template <class, class> class Residual, class Action>
static bool visit_from_pose(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::se2: return visit_target<Residual, PoseSe2>(action);
    case Manifold::se3: return visit_target<Residual, PoseSe3>(action);
    case Manifold::nav: return visit_target<Residual, PoseNav>(action);
    default: return false;
  }
}

template <class Action>
static bool visit_range(const Action& action) {
  if (action.view.manifold[0] != Manifold::vector) return visit_from_pose<Range>(action);
  if (action.view.dof[0] == 2) return visit_target<Range, Point2>(action);
  return action.view.dof[0] == 3 && visit_target<Range, Point3>(action);
}

template <class Action>
static bool visit_position(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::vector: return visit_one_vector<PriorVector>(action);
    case Manifold::se2: return action.template with<Position<PoseSe2>>();
    case Manifold::se3: return action.template with<Position<PoseSe3>>();
    case Manifold::nav: return action.template with<Position<PoseNav>>();
    default: return false;
  }
}

template <class Action>
static bool visit_attitude(const Action& action) {
  const bool variable = action.view.arity == 2;
  switch (action.view.manifold[0]) {
    case Manifold::so3: return variable ? action.template with<Attitude<3, true>>() : action.template with<Attitude<3, false>>();
    case Manifold::se3: return variable ? action.template with<Attitude<6, true>>() : action.template with<Attitude<6, false>>();
    case Manifold::nav: return variable ? action.template with<Attitude<9, true>>() : action.template with<Attitude<9, false>>();
    default: return false;
  }
}

template <template <class, bool> class Residual, class Action>
static bool visit_plane(const Action& action) {
  const bool variable = action.view.arity == 3;
  if (action.view.manifold[0] == Manifold::se3)
    return variable ? action.template with<Residual<PoseSe3, true>>() : action.template with<Residual<PoseSe3, false>>();
  return variable ? action.template with<Residual<PoseNav, true>>() : action.template with<Residual<PoseNav, false>>();
}

template <class Action>
static bool visit_point_to_plane(const Action& action) {
  const FactorView& v = action.view;
  if (v.arity != 2) return visit_plane<PointToPlane>(action);
  const bool extended = v.manifold[1] == Manifold::nav;
  if (v.manifold[0] == Manifold::se3)
    return extended ? action.template with<PointToPlaneBetween<PoseSe3, PoseNav>>()
                    : action.template with<PointToPlaneBetween<PoseSe3, PoseSe3>>();
  return extended ? action.template with<PointToPlaneBetween<PoseNav, PoseNav>>()
                  : action.template with<PointToPlaneBetween<PoseNav, PoseSe3>>();
}

// The graph's own residuals.
struct Own {
  template <class Action>
  static bool visit(const Action& action) {
    switch (action.view.type) {
      case FactorType::custom: return visit_custom(action);
      case FactorType::prior: return visit_prior(action);
      case FactorType::between: return visit_between(action);
      case FactorType::range: return visit_range(action);
      case FactorType::bearing: return visit_from_pose<Bearing>(action);
      case FactorType::landmark: return visit_from_pose<Landmark>(action);
      case FactorType::position: return visit_position(action);
      case FactorType::linear_motion: return visit_two_vectors<LinearMotionVector>(action);
      case FactorType::prior_rows: return visit_rows(action);
      case FactorType::bearing_range: return visit_from_pose<BearingRange>(action);
      case FactorType::attitude: return visit_attitude(action);
      case FactorType::plane: return visit_plane<Plane>(action);
      case FactorType::point_to_plane: return visit_point_to_plane(action);
    }
    return false;
  }
};

}  // namespace
}  // namespace heliograph
