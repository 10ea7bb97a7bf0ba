// SPDX-License-Identifier: MIT
// Between which families each type has a residual, its rows, and the doubles of one measurement.
#include <algorithm>

#include "graph/factors/make_group.hpp"

namespace heliograph {

namespace {

// Dimension of the space that a variable has a point in; 0 if it has none.
int space_of(Manifold manifold, int dof) {
  switch (manifold) {
    case Manifold::vector: return dof == 2 || dof == 3 ? dof : 0;
    case Manifold::se2: return 2;
    case Manifold::se3:
    case Manifold::nav: return 3;
    default: return 0;
  }
}

bool pose_in_space(Manifold manifold) { return manifold == Manifold::se3 || manifold == Manifold::nav; }

// The leading part of a motion with that many rows: its rotation, with position, with velocity. Packed values and tangents
// of SO(3) and SE(3) are the first numbers of those of SE_2(3).
FactorShape leading_part(int rows, int dof) {
  return {rows % 3 == 0 && rows >= 3 && rows <= dof, rows, rows + 6};
}

FactorShape shape_of_prior(const ShapeQuery& q) {
  if (q.rows != 0 && q.rows != q.dof[0] && pose_in_space(q.manifold[0])) return leading_part(q.rows, q.dof[0]);
  return {true, q.dof[0], storage_of(q.manifold[0], q.dof[0])};
}

FactorShape shape_between(const ShapeQuery& q) {
  if (q.arity() == 2 && pose_in_space(q.manifold[0]) && pose_in_space(q.manifold[1])) {
    const int most = std::min(q.dof[0], q.dof[1]);
    return leading_part(q.rows == 0 ? most : q.rows, most);
  }
  if (!q.is(1, q.manifold[0]) || q.dof[0] != q.dof[1] || q.is(0, Manifold::s2)) return {};
  return {true, q.dof[0], storage_of(q.manifold[0], q.dof[0])};
}

FactorShape shape_between_points(FactorType type, const ShapeQuery& q) {
  const int space = space_of(q.manifold[0], q.dof[0]);
  if (space == 0 || space != space_of(q.manifold[1], q.dof[1])) return {};
  if (type == FactorType::range) return {true, 1, 1};
  if (q.is(0, Manifold::vector)) return {};
  if (type == FactorType::bearing_range) return {true, space, space + 1};
  return {true, type == FactorType::bearing ? space - 1 : space, space};
}

FactorShape shape_of_position(Manifold manifold, int dof) {
  const int space = manifold == Manifold::vector ? dof : space_of(manifold, dof);
  return {space > 0, space, space};
}

FactorShape shape_of_rows(const ShapeQuery& q) {
  return {q.rows >= 1 && q.rows <= q.dof[0], q.rows, storage_of(q.manifold[0], q.dof[0]) + q.rows};
}

// A plane's normal and its distance from the origin as variables behind the pose.
bool plane_behind(const ShapeQuery& q) { return q.is(1, Manifold::s2) && q.vector(2, 1); }

FactorShape shape_on_world(FactorType type, const ShapeQuery& q) {
  const Manifold body = q.manifold[0];
  if (type == FactorType::attitude) {
    const bool turned = body == Manifold::so3 || pose_in_space(body);
    if (q.arity() == 1) return {turned, 2, 6};
    return {turned && q.arity() == 2 && q.is(1, Manifold::s2), 2, 3};
  }
  if (!pose_in_space(body)) return {};
  const bool variable = q.arity() == 3 && plane_behind(q);
  if (type == FactorType::plane) return {q.arity() == 1 || variable, 3, variable ? 4 : 8};
  const bool between = q.arity() == 2 && pose_in_space(q.manifold[1]);
  return {q.arity() == 1 || between || variable, 1, variable ? 3 : 7};
}

}  // namespace

FactorShape shape_of(FactorType type, const ShapeQuery& q) {
  if (const ResidualKind* kind = brought_residual(type)) return kind->shape(q);
  const bool single = type == FactorType::prior || type == FactorType::position || type == FactorType::prior_rows;
  const bool pair = type >= FactorType::between && type <= FactorType::bearing_range && !single;
  if ((single && q.arity() != 1) || (pair && q.arity() != 2)) return {};
  switch (type) {
    case FactorType::custom: return {true, q.rows, 0};
    case FactorType::prior: return shape_of_prior(q);
    case FactorType::between: return shape_between(q);
    case FactorType::position: return shape_of_position(q.manifold[0], q.dof[0]);
    case FactorType::linear_motion:
      return {q.vector(0, q.dof[0]) && q.vector(1, q.dof[1]), q.dof[1], q.dof[1] * q.dof[0] + q.dof[1]};
    case FactorType::prior_rows: return shape_of_rows(q);
    case FactorType::range:
    case FactorType::bearing:
    case FactorType::landmark:
    case FactorType::bearing_range: return shape_between_points(type, q);
    case FactorType::attitude:
    case FactorType::plane:
    case FactorType::point_to_plane: return shape_on_world(type, q);
  }
  return {};
}

}  // namespace heliograph
