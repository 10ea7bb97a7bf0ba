"""Weak is not free: what only numbers can tell apart, and freedom counted against singular values."""

import numpy as np
import pytest

from diagnosed import METHODS, accepted, chain, planar, refusal, seen_from
from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import (
    Bearing,
    Between,
    Constrained,
    FactorGraph,
    Huber,
    Information,
    Isotropic,
    Landmark,
    LinearMotion,
    Marginals,
    Position,
    Prior,
    Range,
    SquareRoot,
    TruncatedLeastSquares,
    Values,
    diagnose,
    solve,
)
from heliograph.graph.diagnosis import diagnosis as module
from heliograph.lie import S2, SE2, SE3, se3
from reference.nullity import nullity


@pytest.mark.parametrize("lie", [SE2, SE3])
def test_a_long_chain_is_held_by_one_end(lie):
    graph, values = FactorGraph(), Values()
    chain(graph, values, np.arange(100_000), lie)
    graph.fix(0)
    found = diagnose(graph, values)
    assert found.ok and found.complete
    graph = FactorGraph()
    values = Values()
    T = chain(graph, values, np.arange(5000), lie)
    graph.add(Position([10, 20, 30], T[[10, 20, 30], :-1, -1], Isotropic(100.0)))  # far from the other end
    accepted(graph, values)


@pytest.mark.parametrize("weakest", [1e-4, 1e-9])
def test_weak_information_is_not_none(weakest):
    rng = np.random.default_rng(7)
    graph, values = FactorGraph(), Values()
    keys = np.arange(300)
    T = chain(graph, values, keys, noise=Information(np.diag([1.0, 1.0, weakest, 1.0, weakest, 1.0])))
    j = rng.integers(0, 299, 20)
    keep = np.abs(j - 150) > 2
    graph.add(Between(150, j[keep], SE3(se3.inverse(T[[150]]) @ T[j[keep]]), Information(weakest * np.eye(6))))
    graph.fix(0)
    accepted(graph, values)
    graph = graph.copy()
    loose = FactorGraph()
    for record in graph:
        loose.add(record)
    loose.add(Position(keys[::50], T[::50, :3, 3], Isotropic(1.0 / np.sqrt(weakest))))
    accepted(loose, values)


def test_a_range_network_is_too_entangled_and_is_decided_with_its_factor():
    rng = np.random.default_rng(8)
    points = 10 * rng.normal(size=(30, 3))
    i, j = np.triu_indices(30, 1)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(30), points)
    graph.add(Range(i, j, np.linalg.norm(points[i] - points[j], axis=1), Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 6 and motion.kind == "rigid"
    graph.fix([0, 1])
    (motion,) = diagnose(graph, values).free
    assert motion.kind == "rotation" and motion.directions == 1
    for method in METHODS:
        with pytest.raises(UnderconstrainedError, match="points 2-29 are free to rotate about"):
            solve(graph, values, method)
    graph.fix(2)
    accepted(graph, values)


def linearized(graph, values):
    problem = module.Problem(graph, values)
    problem.linearize()
    return problem


def test_what_a_kernel_rejects_altogether_is_not_silently_kept():
    graph, values = FactorGraph(), Values()
    keys = np.arange(5)
    values.insert(keys, np.arange(5.0)[:, None])
    graph.add(Between(keys[:-1], keys[1:], np.ones(1), Isotropic(0.1)))
    values.insert(9, [50.0])
    graph.fix(0)
    graph.add(Between(4, 9, [1.0], Isotropic(0.1), kernel=TruncatedLeastSquares(3.0)))
    assert diagnose(graph, values).ok
    for method in METHODS:
        (motion,) = solve(graph, values, method).diagnosis.free
        assert motion.text == "vector 9 is free to shift component 0"
    with pytest.raises(UnderconstrainedError, match="vector 9 is free to shift component 0"):
        Marginals(graph, values)
    graph.add(Prior(9, [49.0], Isotropic(1.0), kernel=Huber(1.0)))
    accepted(graph, values)


def test_constraints_and_partial_priors_anchor_together():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(10))
    graph.add(Prior(0, SE3(T[0]), Information(np.diag([1.0, 1, 1, 0, 0, 0]))))
    (motion,) = refusal(graph, values).free
    assert motion.words == "translate in every direction"
    graph.add(Position(9, T[9, :3, 3], Constrained()))
    accepted(graph, values)


def test_two_loose_ends_are_told_one_by_one():
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(30), SE3(np.tile(np.eye(4), (30, 1, 1))))
    keys = np.arange(30)
    loose = np.isin(keys[1:], (10, 20))
    tight = keys[1:][~loose]
    graph.add(Between(tight - 1, tight, SE3.identity(), Isotropic(0.1)))
    for key, axis in ((10, 4), (20, 5)):
        omega = np.eye(6)
        omega[axis, axis] = 0.0
        graph.add(Between(key - 1, key, SE3.identity(), Information(omega)))
    graph.fix(0)
    found = refusal(graph, values)
    assert {motion.text for motion in found.free} == {
        "poses 10-29 are free to translate along y",
        "poses 20-29 are free to translate along z",
    }


def test_bad_graphs_are_named_in_one_line():
    values = Values()
    values.insert([0, 1], SE2(planar()))
    for make, words in (
        (
            lambda g: g.add(Between(0, 1, SE2.identity(), Information(np.diag([1.0, 1.0, -5.0])))),
            "factor 0 .*smallest eigenvalue -5",
        ),
        (lambda g: g.add(Between(0, 1, SE2(np.full((3, 3), np.nan)), Isotropic(1.0))), "factor 0 .*not finite"),
        (
            lambda g: (g.add(Between(0, 17, SE2.identity(), Isotropic(1.0))), diagnose(g, values)),
            "factor 0 .*no value for key 17",
        ),
        (lambda g: (g.fix(99), g.add(Prior(0, SE2.identity(), Isotropic(1.0))), diagnose(g, values)), "key 99"),
        (lambda g: g.add(Between(1, 1, SE2.identity(), Isotropic(1.0))), "with itself"),
    ):
        with pytest.raises(GraphError, match=words) as error:
            make(FactorGraph())
        assert "\n" not in str(error.value)
    with pytest.raises(GraphError, match="key 1 is used twice"):
        values.insert(1, [0.0])


def random_graph(rng):
    """Poses, points and numbers, joined by a few factors of many kinds: mostly undetermined."""
    graph, values = FactorGraph(), Values()
    T, points = SE3.exp(rng.normal(size=(6, 6))).matrix, 5 * rng.normal(size=(5, 3))
    values.insert(np.arange(6), SE3(T))
    values.insert(10 + np.arange(5), points)
    values.insert(20 + np.arange(3), rng.normal(size=(3, 2)))
    for _ in range(rng.integers(4, 14)):
        i, j = rng.choice(6, 2, replace=False)
        p = rng.integers(5)
        masked = np.diag((rng.random(6) < 0.8).astype(float))
        seen = (se3.inverse(T[i]) @ np.r_[points[p], 1.0])[:3]
        kind = rng.integers(7)
        if kind == 0:
            graph.add(Between(i, j, SE3(se3.inverse(T[i]) @ T[j]), Information(masked)))
        elif kind == 1:
            graph.add(Between(i, j, SE3(se3.inverse(T[i]) @ T[j]), Isotropic(0.1)))
        elif kind == 2:
            graph.add(Landmark(i, 10 + p, seen, Information(masked[:3, :3])))
        elif kind == 3:
            graph.add(Bearing(i, 10 + p, S2(seen / np.linalg.norm(seen)), Isotropic(0.1)))
        elif kind == 4:
            graph.add(Range(i, 10 + p, np.linalg.norm(seen), Isotropic(0.1)))
        elif kind == 5:
            graph.add(Position(i, T[i, :3, 3], Information(masked[:3, :3])))
        else:
            a, b = 20 + rng.choice(3, 2, replace=False)
            graph.add(LinearMotion(a, b, rng.normal(size=(2, 2)), [0.0, 0.0], Information(masked[:2, :2])))
    graph.fix(rng.choice([0, 1, 10, 20], rng.integers(0, 3), replace=False))
    return graph, values


@pytest.mark.parametrize("columns", [48, 7])
def test_freedom_is_counted_as_singular_values_count_it(monkeypatch, columns):
    monkeypatch.setattr(module, "_MAX_COLUMNS", columns)
    wrong = []
    for seed in range(150):
        graph, values = random_graph(np.random.default_rng(seed))
        found = diagnose(graph, values)
        scalars, expected = sum(motion.scalars for motion in found.free), nullity(graph, values)
        if scalars != expected and (columns == 48 or (scalars == 0) != (expected == 0)):
            wrong.append((seed, scalars, expected))
    assert not wrong


@pytest.mark.parametrize("method", METHODS)
def test_the_end_counts_where_the_start_hides_the_freedom(method):
    """Poses on a line, started off it: only at the optimum is the roll about the line free."""
    graph, values = FactorGraph(), Values()
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 1, 3] = np.arange(30.0)
    keys = np.arange(30)
    values.insert(keys, SE3(T).retract(0.02 * np.random.default_rng(0).normal(size=(30, 6))))
    graph.add(Between(keys[:-1], keys[1:], SE3(se3.inverse(T[:-1]) @ T[1:]), Isotropic(0.1)))
    graph.add(Position(keys, T[:, :3, 3], Isotropic(1.0)))
    assert diagnose(graph, values).ok
    with pytest.raises(UnderconstrainedError, match="poses 0-29 are free to rotate about y through"):
        solve(graph, values, method, initial="given")


def test_the_start_may_hide_what_the_graph_determines():
    """All landmarks at the origin leave turns about it; the solver leads away from there."""
    rng = np.random.default_rng(0)
    graph, values = FactorGraph(), Values()
    T, points = SE3.exp(rng.normal(size=(4, 6))).matrix, rng.normal(size=(6, 3))
    values.insert(np.arange(4), SE3(T).retract(0.1 * rng.normal(size=(4, 6))))
    values.insert(10 + np.arange(6), np.zeros((6, 3)))
    i, j = np.repeat(np.arange(4), 6), np.tile(np.arange(6), 4)
    seen = np.einsum("nij,nj->ni", se3.inverse(T[i]), np.c_[points[j], np.ones(24)])[:, :3]
    graph.add(Landmark(i, 10 + j, seen, Isotropic(0.1)))
    graph.add(Prior([0, 1], SE3(T[:2]), Isotropic(0.1)))
    assert not diagnose(graph, values).ok
    solution = solve(graph, values)
    np.testing.assert_allclose(solution.values.at(10 + np.arange(6)), points, atol=1e-6)


@pytest.fixture(params=["world", "factor"])
def entangled(request, monkeypatch):
    """Fewer seeds than these graphs need; without motions of the world, inverse iteration has to find everything."""
    monkeypatch.setattr(module, "_MAX_COLUMNS", 3)
    if request.param == "factor":
        monkeypatch.setattr(module._Search, "_unresolved", lambda *_: None)


@pytest.mark.usefixtures("entangled")
@pytest.mark.parametrize("held", [0, 1, 2, 3])
def test_entangled_points_are_decided_by_their_factor(held):
    """Ranges between all points leave the turns and shifts that held points do not stop."""
    rng = np.random.default_rng(8)
    points = 10 * rng.normal(size=(30, 3))
    i, j = np.triu_indices(30, 1)
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(30), points)
    graph.add(Range(i, j, np.linalg.norm(points[i] - points[j], axis=1), Isotropic(0.1)))
    graph.fix(np.arange(held))
    expected = {0: 6, 1: 3, 2: 1, 3: 0}[held]
    if expected:
        found = refusal(graph, values)
        assert sum(motion.directions for motion in found.free) == expected == nullity(graph, values)
    else:
        accepted(graph, values)


@pytest.mark.usefixtures("entangled")
@pytest.mark.parametrize(("placed", "expected"), [(0, 7), (1, 4), (2, 1), (3, 0)])
def test_entangled_cameras_are_decided_by_their_factor(placed, expected):
    """Bearings between cameras and points, some cameras with a position."""
    rng = np.random.default_rng(2)
    graph, values = FactorGraph(), Values()
    T, points = SE3.exp(rng.normal(size=(12, 6))).matrix, 10 * rng.normal(size=(60, 3))
    values.insert(np.arange(12), SE3(T))
    values.insert(200 + np.arange(60), points)
    i, j = np.repeat(np.arange(12), 60), np.tile(np.arange(60), 12)
    graph.add(Bearing(i, 200 + j, seen_from(T[i], points[j]), Isotropic(0.01)))
    for k in range(placed):
        graph.add(Position(k, T[k, :3, 3], Isotropic(10.0)))
    assert not module.inspect(linearized(graph, values)).complete
    if expected:
        found = refusal(graph, values)
        assert sum(motion.directions for motion in found.free) == expected == nullity(graph, values)
    else:
        accepted(graph, values)


def test_next_to_parallel_rays_still_cross():
    """A parallax of a millionth: beyond what the normal equations show, not beyond the Jacobians."""
    graph, values = FactorGraph(), Values()
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, 1, 3] = 1e-5
    point = np.array([[6.0, 5.0, 4.0]])
    values.insert([0, 1], SE3(T))
    values.insert(5, point[0])
    graph.fix([0, 1])
    graph.add(Bearing([0, 1], 5, seen_from(T, np.repeat(point, 2, axis=0)), Isotropic(1e-3)))
    found = diagnose(graph, values)
    assert found.ok and found.complete and found.close


@pytest.mark.parametrize(("weak", "ok"), [(1e-7, True), (0.0, False)])
def test_an_edge_weak_across_its_axes_is_told_from_one_that_knows_nothing(weak, ok):
    Q = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    S = np.eye(6)
    S[3:, 3:] = np.diag([1.0, 1.0, weak]) @ Q.T
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(20))
    F = chain(graph, values, np.arange(20, 40), seed=1)
    graph.add(Between(19, 20, SE3(se3.inverse(T[19]) @ F[0]), SquareRoot(S)))
    graph.fix(0)
    found = diagnose(graph, values)
    assert found.ok is ok and found.complete
    if not ok:
        assert found.free[0].text.startswith("poses 20-39 are free to translate along (")


@pytest.mark.parametrize("seed", range(12))
def test_singular_information_across_the_axes_leaves_no_trace_of_rounding(seed):
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    omega = np.eye(6)
    omega[3:, 3:] = Q @ np.diag([2.0, 1.0, 0.0]) @ Q.T
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(5))
    F = chain(graph, values, np.arange(5, 10), seed=1)
    graph.add(Between(4, 5, SE3(se3.inverse(T[4]) @ F[0]), Information(0.5 * (omega + omega.T))))
    graph.fix(0)
    (motion,) = diagnose(graph, values).free
    assert motion.kind == "translation" and motion.variables == "poses 5-9"
