// SPDX-License-Identifier: MIT
// Compiled once for each instruction set, in a translation unit of its own. Everything here has internal linkage and no
// library template is instantiated, so that no AVX2 code can be merged into the baseline build by the linker.
// This file finds the residual of a group and hands it to an action: linearise, cost or evaluate.
#include "graph/factors/between_blocks.inl"
#include "graph/factors/residuals_point.inl"

namespace heliograph {
namespace {

template <class A, class B>
constexpr bool kIsSame = false;
template <class A>
constexpr bool kIsSame<A, A> = true;

struct Linearize {
  const FactorView& view;
  size_t begin, end;
  double* blocks;
  GroupCost* sum;
  template <class Residual>
  bool with() const {
    if constexpr (kIsSame<Residual, BetweenSe2>) linearize_between_se2(view, begin, end, blocks, sum);
    else if constexpr (kIsSame<Residual, BetweenMotion<1>>) linearize_between_se3(view, begin, end, blocks, sum);
    else linearize_range<Residual>(view, begin, end, blocks, sum);
    return true;
  }
};

struct Cost {
  const FactorView& view;
  size_t begin, end;
  GroupCost* sum;
  template <class Residual>
  bool with() const {
    cost_range<Residual>(view, begin, end, sum);
    return true;
  }
};

struct Evaluate {
  const FactorView& view;
  size_t begin, end;
  double *residual, *jacobian;
  template <class Residual>
  bool with() const {
    evaluate_range<Residual>(view, begin, end, residual, jacobian);
    return true;
  }
};

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

template <class Action>
static bool visit_prior(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::vector: return visit_one_vector<PriorVector>(action);
    case Manifold::so2: return action.template with<PriorSo2>();
    case Manifold::so3: return action.template with<PriorMotion<0>>();
    case Manifold::se2: return action.template with<PriorSe2>();
    case Manifold::se3: return action.template with<PriorMotion<1>>();
    case Manifold::s2: return action.template with<PriorS2>();
    case Manifold::nav: return action.template with<PriorMotion<2>>();
  }
  return false;
}

template <class Action>
static bool visit_between(const Action& action) {
  switch (action.view.manifold[0]) {
    case Manifold::vector: return visit_two_vectors<BetweenVector>(action);
    case Manifold::so2: return action.template with<BetweenSo2>();
    case Manifold::so3: return action.template with<BetweenMotion<0>>();
    case Manifold::se2: return action.template with<BetweenSe2>();
    case Manifold::se3: return action.template with<BetweenMotion<1>>();
    case Manifold::nav: return action.template with<BetweenMotion<2>>();
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
  }
  return false;
}

static bool linearize_factors(const FactorView& view, size_t begin, size_t end, double* blocks, GroupCost* sum) {
  return visit(Linearize{view, begin, end, blocks, sum});
}

static bool cost_factors(const FactorView& view, size_t begin, size_t end, GroupCost* sum) {
  return visit(Cost{view, begin, end, sum});
}

static bool evaluate_factors(const FactorView& view, size_t begin, size_t end, double* residual, double* jacobian) {
  return visit(Evaluate{view, begin, end, residual, jacobian});
}

}  // namespace
}  // namespace heliograph
