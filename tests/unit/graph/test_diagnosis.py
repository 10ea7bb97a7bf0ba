"""What a graph leaves free is found before it is solved, named by keys and by directions, and weak is not free."""

import numpy as np
import pytest

from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import (
    Bearing,
    Between,
    Constrained,
    Factor,
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
from heliograph.graph import diagnosis as module
from heliograph.lie import S2, SE2, SE3, SO3, ExtendedPose, se2, se3
from reference.nullity import nullity

METHODS = ("gn", "lm", "dogleg")


def steps(rng, lie, count):
    """Relative motions of about a metre forward."""
    xi = 0.2 * rng.normal(size=(count, lie.dof))
    xi[:, lie.dof // 2] += 1.0
    return lie.exp(xi)


def chain(graph, values, keys, lie=SE3, seed=0, noise=None):
    """Poses after one another, from odometry; returned as matrices (N, k, k)."""
    keys = np.asarray(keys)
    Z = steps(np.random.default_rng(seed), lie, len(keys) - 1).matrix
    T = [np.eye(lie.size)]
    for z in Z:
        T.append(T[-1] @ z)
    T = np.array(T)
    values.insert(keys, lie(T))
    graph.add(Between(keys[:-1], keys[1:], lie(Z), noise or Isotropic(0.1)))
    return T


def refusal(graph, values):
    """The diagnosis, after every solver and the marginals refused with the same words."""
    found = diagnose(graph, values)
    assert not found.ok
    for method in METHODS:
        with pytest.raises(UnderconstrainedError) as error:
            solve(graph, values, method)
        assert str(error.value) == found.message
        assert error.value.diagnosis.free[0].text == found.free[0].text
    with pytest.raises(UnderconstrainedError) as error:
        Marginals(graph, values)
    assert str(error.value) == found.message
    return found


def accepted(graph, values, method="lm"):
    assert diagnose(graph, values).ok
    solution = solve(graph, values, method)
    assert solution.status == "converged" and solution.diagnosis.ok
    return solution


@pytest.mark.parametrize(("lie", "freedom"), [(SE3, 6), (SE2, 3)])
def test_a_floating_component_is_told_from_the_anchored_one(lie, freedom):
    graph, values = FactorGraph(), Values()
    chain(graph, values, np.arange(100), lie)
    chain(graph, values, np.arange(120, 341), lie, seed=1)
    graph.fix(0)
    found = refusal(graph, values)
    assert found.components == 2
    (motion,) = found.free
    assert motion.directions == motion.scalars == freedom
    assert (motion.keys == np.arange(120, 341)).all()
    assert motion.kind == "rigid" and motion.component == 1
    assert motion.text.startswith("poses 120-340 are free to move as a whole (translate in every direction and rotate")
    assert "graph.fix(120)" in found.message and "component 2 of 2" in found.message


def test_a_held_variable_or_a_prior_anchors_a_component():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(20))
    chain(graph, values, np.arange(30, 50), seed=1)
    graph.fix(4)
    graph.add(Prior(40, SE3(T[3]), Isotropic(1.0)))
    found = diagnose(graph, values)
    assert found.ok and found.complete and found.components == 2
    assert found.message == "the graph determines every variable"


def test_positions_on_a_straight_line_leave_the_roll_about_it():
    graph, values = FactorGraph(), Values()
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 1, 3], T[:, 2, 3] = np.arange(30.0), 7.0
    keys = np.arange(30)
    values.insert(keys, SE3(T))
    graph.add(Between(keys[:-1], keys[1:], SE3(se3.inverse(T[:-1]) @ T[1:]), Isotropic(0.1)))
    graph.add(Position(keys, T[:, :3, 3], Isotropic(1.0)))
    (motion,) = refusal(graph, values).free
    assert (motion.kind, motion.directions) == ("rotation", 1)
    assert motion.text == "poses 0-29 are free to rotate about y through (0, 14.5, 7)"
    bent = T.copy()
    bent[20:, 0, 3] += np.arange(10.0)
    values.update(keys, SE3(bent))
    other = FactorGraph()
    other.add(Between(keys[:-1], keys[1:], SE3(se3.inverse(bent[:-1]) @ bent[1:]), Isotropic(0.1)))
    other.add(Position(keys, bent[:, :3, 3], Isotropic(1.0)))
    accepted(other, values)


def test_knowing_what_is_down_leaves_the_vertical_turn_and_the_place():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(20))
    graph.add(Prior(0, SE3(T[0]), Information(np.diag([1.0, 1, 0, 0, 0, 0]))))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 4
    assert motion.words.startswith("translate in every direction and rotate about z through")


def test_an_edge_that_knows_nothing_of_z_frees_the_far_side_along_it():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(100))
    far = np.arange(100, 180)
    F = chain(graph, values, far, seed=2)
    # in the frame of 100, which is the world's
    omega = np.diag([1.0, 1, 1, 1, 1, 0])
    graph.add(Between(99, 100, SE3(se3.inverse(T[99]) @ F[0]), Information(omega)))
    graph.fix(0)
    (motion,) = refusal(graph, values).free
    assert motion.text == "poses 100-179 are free to translate along z"
    assert motion.kind == "translation" and "Position" in motion.remedy


def test_singular_information_that_no_axis_shows_is_found_all_the_same():
    rng = np.random.default_rng(5)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    omega = np.zeros((6, 6))
    omega[:3, :3] = np.eye(3)
    omega[3:, 3:] = Q @ np.diag([2.0, 1.0, 0.0]) @ Q.T
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE3(np.stack([np.eye(4), np.eye(4)])))
    graph.add(Between(0, 1, SE3.identity(), Information(0.5 * (omega + omega.T))))
    graph.fix(0)
    (motion,) = refusal(graph, values).free
    direction = Q[:, 2] * np.sign(Q[np.argmax(np.abs(Q[:, 2])), 2])
    shown = ", ".join(f"{x:.3g}" for x in direction)
    assert motion.text == f"pose 1 is free to translate along ({shown})"


def seen_from(T, points):
    p = (se3.inverse(T) @ np.concatenate([points, np.ones((len(points), 1))], axis=1)[:, :, None])[:, :3, 0]
    return S2(p / np.linalg.norm(p, axis=1, keepdims=True))


def test_landmarks_with_one_bearing_have_no_depth():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(20))
    graph.fix(0)
    points = np.random.default_rng(3).normal(size=(50, 3)) * 10
    values.insert(np.arange(500, 550), points)
    graph.add(Bearing(3, 500, seen_from(T[[3]], points[:1]), Isotropic(0.1)))
    lonely = graph.copy()
    one = Values()
    one.insert(np.arange(20), SE3(T))
    one.insert(500, points[0])
    (motion,) = refusal(lonely, one).free
    ray = points[0] - T[3, :3, 3]
    ray *= np.sign(ray[np.argmax(np.abs(ray))]) / np.linalg.norm(ray)
    assert motion.text == "point 500 is free to translate along (" + ", ".join(f"{x:.3g}" for x in ray) + ")"
    graph.add(
        Bearing(
            np.arange(1, 50) % 20, np.arange(501, 550), seen_from(T[np.arange(1, 50) % 20], points[1:]), Isotropic(0.1)
        )
    )
    (motion,) = refusal(graph, values).free
    assert motion.text == "points 500-549 are each free to move in 1 of 3 directions"
    assert motion.scalars == 50
    graph.add(
        Bearing(np.arange(50) % 20, np.arange(500, 550), seen_from(T[np.arange(50) % 20], points), Isotropic(0.1))
    )
    graph.add(
        Bearing(
            (np.arange(50) + 9) % 20,
            np.arange(500, 550),
            seen_from(T[(np.arange(50) + 9) % 20], points),
            Isotropic(0.1),
        )
    )
    accepted(graph, values)


def test_a_pose_with_ranges_only_turns_on_the_spot():
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE2(planar()))
    values.insert([5, 6], [[3.0, 4.0], [-2.0, 5.0]])
    graph.fix([0, 5, 6])
    graph.add(Range(0, 1, 2.3, Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 2
    graph.add(Range([1, 1], [5, 6], [2.9, 4.2], Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.text == "pose 1 is free to rotate about (1, 2)"


def planar():
    T = np.stack([np.eye(3), np.eye(3)])
    c, s = np.cos(0.3), np.sin(0.3)
    T[1] = [[c, -s, 1.0], [s, c, 2.0], [0.0, 0.0, 1.0]]
    return T


def test_variables_without_factors_are_named_unless_held():
    graph, values = FactorGraph(), Values()
    chain(graph, values, np.arange(10))
    values.insert([70, 90], [[1.0, 2.0], [3.0, 4.0]])
    values.insert(33, SO3.identity())
    graph.fix([0, 90])
    found = refusal(graph, values)
    assert [motion.text for motion in found.free] == ["rotation 33 has no factor", "point 70 has no factor"]
    graph.fix([33, 70])
    accepted(graph, values)


@pytest.mark.parametrize(
    ("dimension", "words"),
    [
        (1, "shift component 0"),
        (2, "translate in every direction"),
        (3, "translate in every direction"),
        (5, "shift components 0, 1, 2, 3 and 4"),
    ],
)
def test_differences_of_vectors_leave_their_common_shift(dimension, words):
    graph, values = FactorGraph(), Values()
    keys = np.arange(10)
    values.insert(keys, np.random.default_rng(1).normal(size=(10, dimension)))
    graph.add(Between(keys[:-1], keys[1:], np.ones(dimension), Isotropic(1.0)))
    (motion,) = refusal(graph, values).free
    assert (motion.words, motion.directions) == (words, dimension)
    graph.add(Prior(4, np.zeros(dimension), Information(np.diag([0.0] + [1.0] * (dimension - 1)))))
    if dimension > 1:
        (motion,) = refusal(graph, values).free
        assert motion.directions == 1 and motion.words.endswith("0" if dimension == 5 else " x")


def test_a_filter_whose_velocity_nothing_shows_is_refused():
    graph, values = FactorGraph(), Values()
    keys = np.arange(6)
    values.insert(keys, np.zeros((6, 2)))
    F = np.array([[1.0, 0.0], [0.0, 1.0]])  # position and velocity that do not meet
    graph.add(LinearMotion(keys[:-1], keys[1:], F, [0.0, 0.0], Isotropic(1.0)))
    graph.add(Prior(keys, np.zeros((6, 2)), Information(np.diag([1.0, 0.0]))))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 1 and motion.words == "translate along y"
    F[0, 1] = 1.0
    graph = FactorGraph()
    graph.add(LinearMotion(keys[:-1], keys[1:], F, [0.0, 0.0], Isotropic(1.0)))
    graph.add(Prior(keys, np.zeros((6, 2)), Information(np.diag([1.0, 0.0]))))
    accepted(graph, values)


def test_landmarks_float_with_the_poses_that_see_them():
    graph, values = FactorGraph(), Values()
    T = chain(graph, values, np.arange(15), SE2)
    points = np.random.default_rng(1).normal(size=(15, 2))
    values.insert(np.arange(100, 115), (T[:, :2, :2] @ points[:, :, None])[:, :, 0] + T[:, :2, 2])
    graph.add(Landmark(np.arange(15), np.arange(100, 115), points, Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.variables == "poses 0-14 and points 100-114"
    assert motion.directions == 3


def test_bearings_alone_leave_the_size_of_everything():
    rng = np.random.default_rng(2)
    graph, values = FactorGraph(), Values()
    T, points = SE3.exp(rng.normal(size=(8, 6))).matrix, 10 * rng.normal(size=(40, 3))
    values.insert(np.arange(8), SE3(T))
    values.insert(np.arange(200, 240), points)
    i, j = np.repeat(np.arange(8), 40), np.tile(np.arange(40), 8)
    graph.add(Bearing(i, 200 + j, seen_from(T[i], points[j]), Isotropic(0.01)))
    whole = refusal(graph, values).free
    assert sorted(motion.directions for motion in whole) == [1, 6]
    graph.fix(0)
    (motion,) = refusal(graph, values).free
    assert motion.kind == "scale" and motion.words == "grow and shrink as a whole"
    graph.fix(200)
    accepted(graph, values)


def test_extended_poses_also_leave_their_velocity():
    graph, values = FactorGraph(), Values()
    keys = np.arange(8)
    X = ExtendedPose.exp(0.3 * np.random.default_rng(1).normal(size=(8, 9)))
    values.insert(keys, X)
    graph.add(Between(keys[:-1], keys[1:], ExtendedPose(np.linalg.inv(X.matrix[:-1]) @ X.matrix[1:]), Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 9
    assert "change its velocity in every direction" in motion.words


class OwnBetween(Factor):
    """Differences without Jacobians of its own."""

    variables = (SE2, SE2)
    rows = 3

    @staticmethod
    def residual(T_world_i, T_world_j, T_i_j):
        return se2.log(se2.inverse(T_i_j) @ se2.inverse(T_world_i) @ T_world_j)


def test_custom_factors_with_numeric_derivatives_are_judged_too():
    graph, values = FactorGraph(), Values()
    T = planar_chain(60)
    keys = np.arange(60)
    values.insert(keys, SE2(T))
    graph.add(OwnBetween((keys[:-1], keys[1:]), data=(se2.inverse(T[:-1]) @ T[1:],), noise=Isotropic(0.1)))
    graph.add(OwnBetween((keys[:-20], keys[20:]), data=(se2.inverse(T[:-20]) @ T[20:],), noise=Isotropic(0.1)))
    (motion,) = refusal(graph, values).free
    assert motion.directions == 3 and motion.variables == "poses 0-59"
    graph.fix(7)
    accepted(graph, values)


def planar_chain(count):
    T = [np.eye(3)]
    for z in steps(np.random.default_rng(4), SE2, count - 1).matrix:
        T.append(T[-1] @ z)
    return np.array(T)


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
    monkeypatch.setattr(module, "_MOST_COLUMNS", columns)
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
    monkeypatch.setattr(module, "_MOST_COLUMNS", 3)
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
