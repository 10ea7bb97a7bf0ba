"""The chordal start against dense least squares, and where there is more in the graph than relative poses."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    Between,
    Covariance,
    Diagonal,
    FactorGraph,
    Information,
    Isotropic,
    Landmark,
    Position,
    Prior,
    Values,
    solve,
    solve_robust,
)
from heliograph.graph.batch.chordal import chordal_values, nearest_rotations
from heliograph.graph.problem.linear import connected
from heliograph.graph.problem.resolve import resolve, resolve_fixed
from heliograph.lie import SE2, SE3, SO3
from reference import chordal as reference


def _chordal(graph, values):
    return chordal_values(resolve(graph, values), values, resolve_fixed(graph, values))


def _tangents(group, rng, n, turn=1.5, reach=4.0):
    k = 1 if group is SE2 else 3
    return np.concatenate([turn * rng.normal(size=(n, k)), reach * rng.normal(size=(n, group.dof - k))], axis=1)


def _world(group, rng, n=12, loops=10, noise=0.0):
    """Return true poses, and edges along a chain and between random pairs, every third one backwards."""
    T = group.exp(_tangents(group, rng, n))
    i = np.concatenate([np.arange(n - 1), rng.integers(0, n, loops)])
    j = np.concatenate([np.arange(1, n), rng.integers(0, n, loops)])
    i, j = i[i != j], j[i != j]
    i[::3], j[::3] = j[::3].copy(), i[::3].copy()
    Z = T[i].inverse() @ T[j]
    return T, i, j, Z.retract(noise * rng.normal(size=(len(i), group.dof)))


@pytest.mark.parametrize("group", [SE2, SE3])
def test_chordal_start_is_exact_without_noise_from_any_values(group, rng):
    T, i, j, Z = _world(group, rng)
    values = Values()
    values.insert(np.arange(12), group.exp(_tangents(group, rng, 12)))
    values.update(3, T[3])
    graph = FactorGraph()
    graph.add(Between(i, j, Z, Diagonal(rng.uniform(0.1, 2.0, (len(i), group.dof)))))
    graph.fix(3)
    np.testing.assert_allclose(_chordal(graph, values).block(group)[1].matrix, T.matrix, atol=1e-9)


@pytest.mark.parametrize("group", [SE2, SE3])
def test_chordal_start_agrees_with_dense_least_squares(group, rng):
    T, i, j, Z = _world(group, rng, noise=0.3)
    root = rng.normal(size=(len(i), group.dof, group.dof)) + 2.0 * np.eye(group.dof)
    omega = np.swapaxes(root, 1, 2) @ root
    values = Values()
    values.insert(100 + np.arange(12), T)
    graph = FactorGraph()
    graph.add(Between(100 + i[:5], 100 + j[:5], Z[:5], Information(omega[:5])))
    graph.add(Between(100 + i[5:], 100 + j[5:], Z[5:], Covariance(np.linalg.inv(omega[5:]))))
    graph.fix(100)
    found = _chordal(graph, values).block(group)[1].matrix
    d = 2 if group is SE2 else 3
    k = group.dof - d
    weight = np.trace(omega[:, :k, :k], axis1=1, axis2=2) / k
    R = reference.rotations(12, i, j, Z.matrix[:, :d, :d], weight, T.matrix[0, :d, :d])
    np.testing.assert_allclose(found[:, :d, :d], R, atol=1e-9)
    t = reference.translations(12, i, j, Z.matrix, omega[:, k:, k:], R, T.matrix[0, :d, d])
    np.testing.assert_allclose(found[:, :d, d], t, atol=1e-8)


def test_chordal_start_of_rotations_alone(rng):
    R = SO3.exp(rng.normal(size=(8, 3)))
    i, j = np.arange(8), (np.arange(8) + 1) % 8
    values = Values()
    values.insert(i, SO3.exp(rng.normal(size=(8, 3))))
    values.update(0, R[0])
    graph = FactorGraph()
    graph.add(Between(i, j, R[i].inverse() @ R[j], Isotropic(0.1)))
    graph.fix(0)
    np.testing.assert_allclose(_chordal(graph, values).block(SO3)[1].matrix, R.matrix, atol=1e-9)


def test_chordal_start_keeps_components_priors_and_what_it_does_not_know(rng):
    T, i, j, Z = _world(SE3, rng, n=6, loops=4)
    graph, values = FactorGraph(), Values()
    start = SE3.exp(_tangents(SE3, rng, 13))
    values.insert(np.arange(13), start)
    values.insert(50, [1.0, 2.0])
    graph.add(Between(i, j, Z, Isotropic(0.1)))  # poses 0-5 with a prior on 2
    graph.add(Prior(2, T[2], Isotropic(0.1)))
    graph.add(Between(6 + i, 6 + j, Z, Isotropic(0.1)))  # poses 6-11 with nothing
    graph.add(Prior(12, T[0], Isotropic(0.1)))  # a pose by itself
    found = _chordal(graph, values)
    poses = found.block(SE3)[1]
    np.testing.assert_allclose(poses.matrix[:6], T.matrix, atol=1e-9)
    moved = start[6] @ T[0].inverse()
    np.testing.assert_allclose(poses.matrix[6:12], (moved @ T).matrix, atol=1e-9)
    np.testing.assert_array_equal(poses.matrix[12], start.matrix[12])
    np.testing.assert_array_equal(found.at(50), [1.0, 2.0])


@pytest.mark.parametrize("group", [SE2, SE3])
def test_chordal_start_turns_to_positions_and_places_landmarks(group, rng):
    d = 2 if group is SE2 else 3
    T, i, j, Z = _world(group, rng)
    points = rng.normal(size=(5, d))
    seen_by, seen = rng.integers(0, 12, 30), rng.integers(0, 5, 30)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(12), group.exp(_tangents(group, rng, 12)))
    values.insert(200 + np.arange(5), np.zeros((5, d)))
    graph.add(Between(i, j, Z, Isotropic(0.1)))
    local = (T[seen_by].inverse().matrix @ np.c_[points[seen], np.ones(30)][:, :, None])[:, :d, 0]
    graph.add(Landmark(seen_by, 200 + seen, local, Isotropic(0.2)))
    graph.add(Position([1, 4, 7, 9], T.matrix[[1, 4, 7, 9], :d, d], Isotropic(0.3)))
    found = _chordal(graph, values)
    np.testing.assert_allclose(found.block(group)[1].matrix, T.matrix, atol=1e-8)
    placed = np.isin(np.arange(5), seen)
    np.testing.assert_allclose(found.block(d)[1][placed], points[placed], atol=1e-8)


def test_chordal_start_needs_relative_rotations():
    values = Values()
    values.insert([0, 1], [[0.0, 0.0], [1.0, 1.0]])
    graph = FactorGraph()
    graph.add(Between(0, 1, [1.0, 0.0], Isotropic(1.0)))
    graph.fix(0)
    assert _chordal(graph, values) is None
    with pytest.raises(GraphError, match="no chordal start"):
        solve(graph, values, initial="chordal")


def test_nearest_rotations_have_determinant_one(rng):
    for d in (2, 3):
        M = rng.normal(size=(200, d, d))
        R = nearest_rotations(M)
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(d), (200, 1, 1)), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
        turned = nearest_rotations(R @ np.tile(np.eye(d), (200, 1, 1)) * 7.0)
        np.testing.assert_allclose(turned, R, atol=1e-12)
        # No rotation nearby is nearer.
        for _ in range(20):
            other = nearest_rotations(R + 0.1 * rng.normal(size=R.shape))
            assert (np.linalg.norm(M - R, axis=(1, 2)) <= np.linalg.norm(M - other, axis=(1, 2)) + 1e-9).all()


def test_connected_finds_components(rng):
    i = np.concatenate([np.arange(99), 100 + np.arange(49)])
    mixed = rng.permutation(len(i))
    swap = rng.random(len(i)) < 0.5
    a, b = np.where(swap, i, i + 1)[mixed], np.where(swap, i + 1, i)[mixed]
    label = connected(151, a, b)
    assert (label[:100] == 0).all()
    assert (label[100:150] == 100).all()
    assert label[150] == 150


@pytest.mark.parametrize("group", [SE2, SE3])
def test_chordal_start_turns_to_held_landmarks(group, rng):
    d = 2 if group is SE2 else 3
    T, i, j, Z = _world(group, rng)
    points = rng.normal(size=(6, d))
    seen_by, seen = rng.integers(0, 12, 30), np.arange(30) % 6
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(12), group.exp(_tangents(group, rng, 12)))
    values.insert(200 + np.arange(6), np.where(np.arange(6)[:, None] < 5, points, 0.0))
    graph.add(Between(i, j, Z, Isotropic(0.1)))
    local = (T[seen_by].inverse().matrix @ np.c_[points[seen], np.ones(30)][:, :, None])[:, :d, 0]
    graph.add(Landmark(seen_by, 200 + seen, local, Isotropic(0.2)))
    graph.fix(200 + np.arange(5))
    found = _chordal(graph, values)
    np.testing.assert_allclose(found.block(group)[1].matrix, T.matrix, atol=1e-8)
    np.testing.assert_allclose(found.block(d)[1], points, atol=1e-8)


def _turned_pair(group):
    """Two poses one step apart, the second started far off."""
    values = Values()
    values.insert(0, group.identity())
    far = np.zeros(group.dof)
    far[[0 if group is SE2 else 2, -2]] = 2.0, 1.0
    values.insert(1, group.exp(far))
    step = np.zeros(group.dof)
    step[-2] = 1.0
    graph = FactorGraph()
    graph.add(Between(0, 1, group.exp(step), Isotropic(0.1)))
    return graph, values


@pytest.mark.parametrize("initial", ["auto", "chordal"])
@pytest.mark.parametrize("group", [SE2, SE3])
def test_prior_alone_is_anchor_enough_for_a_chordal_start(group, initial):
    graph, values = _turned_pair(group)
    graph.add(Prior(0, group.identity(), Isotropic(0.1)))
    solution = solve(graph, values, initial=initial)
    assert solution.start.startswith("chordal")
    assert solution.chi2 == pytest.approx(0.0, abs=1e-18)


@pytest.mark.parametrize("group", [SE2, SE3])
def test_prior_on_every_pose_is_no_obstacle_to_a_chordal_start(group):
    graph, values = _turned_pair(group)
    graph.add(Prior([0, 1], values.block(group)[1], Isotropic(10.0)))
    solution = solve(graph, values, initial="chordal")
    assert solution.start.startswith("chordal")
    assert solution.chi2 == pytest.approx(solve(graph, solution.values, initial="given").chi2)


def test_prior_and_false_loops_let_the_end_be_doubted(rng):
    n = 30
    T = SE2.exp(np.arange(n)[:, None] * [2 * np.pi / n, 1.0, 0.0])
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(n), T)
    i = np.arange(n - 1)
    graph.add(Between(i, i + 1, T[i].inverse() @ T[i + 1], Isotropic(0.01)))
    graph.add(Between(np.zeros(8, int), 2 + np.arange(8), SE2.exp(rng.normal(size=(8, 3))), Isotropic(0.01)))
    graph.add(Prior(0, T[0], Isotropic(0.1)))
    assert solve(graph, values).chi2 > 3.0 * 3 * 8  # so the end is poor, and a second start was looked for


@pytest.mark.parametrize("kinds", [["fix"], ["prior"], ["position"], ["prior", "fix"], ["landmark"]])
def test_empty_groups_of_every_kind_change_nothing(kinds, rng):
    T, i, j, Z = _world(SE2, rng)
    values, graph, none = Values(), FactorGraph(), np.zeros(0, dtype=int)
    values.insert(np.arange(12), SE2.exp(_tangents(SE2, rng, 12)))
    values.insert(none, np.zeros((0, 2)))
    graph.add(Between(i, j, Z, Isotropic(0.1)))
    graph.add(Between(none, none, SE2.identity((0,)), Isotropic(0.1)))
    graph.add(Prior(none, SE2.identity((0,)), Isotropic(0.1)))
    graph.add(Position(none, np.zeros((0, 2)), Isotropic(0.1)))
    graph.add(Landmark(none, none, np.zeros((0, 2)), Isotropic(0.1)))
    graph.fix(none)
    if "fix" in kinds:
        values.update(3, T[3])
        graph.fix(3)
    if "prior" in kinds:
        graph.add(Prior(3, T[3], Isotropic(0.1)))
    if "position" in kinds:
        graph.add(Position([1, 4, 7], T.translation[[1, 4, 7]], Isotropic(0.1)))
    if "landmark" in kinds:
        values.insert([100, 101], [[1.0, 2.0], [-3.0, 1.0]])
        seen = [T[k].inverse() @ np.array(p) for k, p in ((0, [1.0, 2.0]), (5, [-3.0, 1.0]))]
        graph.add(Landmark([0, 5], [100, 101], np.stack(seen), Isotropic(0.1)))
        graph.fix([100, 101])
    for initial in ("auto", "chordal"):
        assert solve(graph, values, initial=initial).chi2 == pytest.approx(0.0, abs=1e-12)
    assert solve_robust(graph, values).chi2 == pytest.approx(0.0, abs=1e-8)
