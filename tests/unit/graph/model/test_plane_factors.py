"""Attitude, planes and points on planes: residuals of the twins, derivatives, and graphs that hold them."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import Attitude, FactorGraph, Isotropic, Plane, PointToPlane, Position, Prior, Values, solve
from heliograph.lie import S2, SE3, SO3, ExtendedPose
from native_records import assert_record
from reference import sensors as twin

COUNT, KEYS = 5, np.arange(5)
ONE = Isotropic(1.0)


def poses(lie, rng):
    return lie.exp(np.hstack([rng.normal(size=(COUNT, 3)), rng.normal(scale=4.0, size=(COUNT, lie.dof - 3))]))


def directions(rng):
    return S2(rng.normal(size=(COUNT, 3)))


def seen(R, direction, rng):
    """The direction in the body's frame, up to 2 rad off."""
    local = np.einsum("nji,nj->ni", R[:, :3, :3], direction.vector)
    return S2(local).retract(rng.normal(scale=0.7, size=(COUNT, 2)))


@pytest.mark.parametrize("lie", [SO3, SE3, ExtendedPose])
def test_attitude_is_its_twin(lie, rng):
    T, world = poses(lie, rng), directions(rng)
    z = seen(T.matrix, world, rng)
    known = Attitude(KEYS, z, ONE, world=world)
    assert_record(known, [T], lambda k, T: twin.attitude(T, world.vector[k], z.vector[k]))
    variable = Attitude(KEYS, z, ONE, world=10 + KEYS)
    assert_record(variable, [T, world], lambda k, T, d: twin.attitude(T, d, z.vector[k]))


@pytest.mark.parametrize("lie", [SE3, ExtendedPose])
def test_plane_is_its_twin(lie, rng):
    T, normal, distance = poses(lie, rng), directions(rng), rng.normal(size=COUNT)
    z, length = seen(T.matrix, normal, rng), rng.normal(size=COUNT)
    known = Plane(KEYS, z, length, ONE, plane=(normal, distance))
    assert_record(known, [T], lambda k, T: twin.plane(T, normal.vector[k], distance[k], z.vector[k], length[k]))
    variable = Plane(KEYS, z, length, ONE, plane=(10 + KEYS, 20 + KEYS))
    assert_record(
        variable,
        [T, normal, distance[:, None]],
        lambda k, T, n, d: twin.plane(T, n, d[0], z.vector[k], length[k]),
    )


@pytest.mark.parametrize("lie", [SE3, ExtendedPose])
def test_point_to_plane_is_its_twin(lie, rng):
    T, normal, distance = poses(lie, rng), directions(rng), rng.normal(size=COUNT)
    q = rng.normal(scale=3.0, size=(COUNT, 3))
    known = PointToPlane(KEYS, q, ONE, plane=(normal, distance))
    assert_record(known, [T], lambda k, T: twin.point_to_plane(T, normal.vector[k], distance[k], q[k]))
    variable = PointToPlane(KEYS, q, ONE, plane=(10 + KEYS, 20 + KEYS))
    assert_record(variable, [T, normal, distance[:, None]], lambda k, T, n, d: twin.point_to_plane(T, n, d[0], q[k]))


@pytest.mark.parametrize("first", [SE3, ExtendedPose])
@pytest.mark.parametrize("second", [SE3, ExtendedPose])
def test_point_to_plane_of_another_pose_is_its_twin(first, second, rng):
    T_i, T_j, normal, distance = poses(first, rng), poses(second, rng), directions(rng), rng.normal(size=COUNT)
    q = rng.normal(scale=3.0, size=(COUNT, 3))
    factor = PointToPlane(KEYS, q, ONE, plane=(normal, distance), seen_by=10 + KEYS)
    np.testing.assert_array_equal(factor.keys, np.stack([10 + KEYS, KEYS], axis=1))

    def of_poses(k, T_i, T_j):
        a, b = np.eye(4), np.eye(4)
        a[:3], b[:3] = T_i[:3, :4], T_j[:3, :4]
        return twin.point_to_plane(np.linalg.solve(a, b), normal.vector[k], distance[k], q[k])

    assert_record(factor, [T_i, T_j], of_poses)


def test_planes_and_poses_are_found_together(rng):
    """Three walls at right angles seen from six poses; the first pose is known, the planes are not."""
    normals, distances = S2(np.eye(3)), np.array([3.0, -2.0, 5.0])
    T = SE3.exp(0.5 * rng.normal(size=(6, 6)))
    graph, values = FactorGraph(), Values()
    graph.add(Prior(0, T[0], Isotropic(0.01)))
    keys, walls = np.repeat(np.arange(6), 3), np.tile(np.arange(3), 6)
    R, p = T.matrix[keys, :3, :3], T.matrix[keys, :3, 3]
    local = S2(np.einsum("nji,nj->ni", R, normals.vector[walls]))
    lengths = distances[walls] - np.einsum("ni,ni->n", normals.vector[walls], p)
    graph.add(Plane(keys, local, lengths, Isotropic(0.01), plane=(100 + walls, 200 + walls)))
    values.insert(np.arange(6), T.retract(0.1 * rng.normal(size=(6, 6))))
    values.insert(100 + np.arange(3), normals.retract(0.1 * rng.normal(size=(3, 2))))
    values.insert(200 + np.arange(3), distances[:, None] + 0.1)
    found = solve(graph, values).values
    np.testing.assert_allclose(found.at(np.arange(6)).matrix, T.matrix, atol=1e-6)
    np.testing.assert_allclose(found.at(100 + np.arange(3)).vector, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(found.at(200 + np.arange(3))[:, 0], distances, atol=1e-6)


def test_gravity_levels_a_pose_and_leaves_its_heading(rng):
    """With the direction of gravity and a position the heading alone stays free, and is named."""
    T = SE3.exp(0.5 * rng.normal(size=6))
    down = S2([0.0, 0.0, -1.0])
    graph, values = FactorGraph(), Values()
    graph.add(Attitude(0, S2(T.matrix[:3, :3].T @ down.vector), Isotropic(0.01), world=down))
    graph.add(Position(0, T.matrix[:3, 3], Isotropic(0.1)))
    values.insert(0, T)
    with pytest.raises(GraphError, match=r"free to (turn|rotate)"):
        solve(graph, values)


def test_what_is_no_plane_is_refused():
    with pytest.raises(GraphError, match="a plane is a tuple"):
        Plane(0, S2([0.0, 0.0, 1.0]), 1.0, ONE, plane=S2([0.0, 0.0, 1.0]))
    with pytest.raises(GraphError, match="points have 3 coordinates"):
        PointToPlane(0, np.zeros(2), ONE, plane=(S2([0.0, 0.0, 1.0]), 1.0))
    with pytest.raises(GraphError, match="known in its frame"):
        PointToPlane(0, np.zeros(3), ONE, plane=(5, 6), seen_by=1)
    with pytest.raises(GraphError, match="a direction is an S2"):
        Attitude(0, np.array([0.0, 0.0, 1.0]), ONE, world=S2([0.0, 0.0, 1.0]))
    with pytest.raises(GraphError, match="not finite"):
        FactorGraph().add(PointToPlane(0, [np.nan, 0.0, 0.0], ONE, plane=(S2([0.0, 0.0, 1.0]), 1.0)))
