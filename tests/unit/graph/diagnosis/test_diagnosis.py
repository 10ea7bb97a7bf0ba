"""What a graph leaves free is found before it is solved, named by keys and by directions, and weak is not free."""

import numpy as np
import pytest

from diagnosed import accepted, chain, planar, planar_chain, refusal, seen_from
from heliograph.graph import (
    Bearing,
    Between,
    Factor,
    FactorGraph,
    Information,
    Isotropic,
    Landmark,
    LinearMotion,
    Position,
    Prior,
    Range,
    Values,
    diagnose,
    solve,
)
from heliograph.graph.diagnosis import diagnosis
from heliograph.graph.diagnosis.diagnosis import inspect
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, SE3, SO3, ExtendedPose, se2, se3
from reference.nullity import nullity


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


class Delayed(Factor):
    """A pose that was measured late, by two clocks."""

    variables = (SE3, 1, 1)
    rows = 6

    @staticmethod
    def residual(T_world_body, first, second, T_measured, rate):
        return se3.log(se3.inverse(T_measured) @ T_world_body) + (first + second) * rate

    @staticmethod
    def jacobians(T_world_body, _first, _second, T_measured, rate):
        r = se3.log(se3.inverse(T_measured) @ T_world_body)
        return se3.right_jacobian_inverse(r), rate[:, :, None], rate[:, :, None]


def test_small_variables_that_are_free_together_are_named_among_large_ones():
    graph, values, poses = FactorGraph(), Values(), np.arange(6)
    T = np.tile(np.eye(4), (6, 1, 1))
    values.insert(poses, SE3(T))
    values.insert([100, 101], np.zeros((2, 1)))
    graph.add(Prior(poses, SE3(T), Isotropic(1e3)))
    data = (T, np.tile(np.arange(1.0, 7.0), (6, 1)))
    graph.add(Delayed((poses, np.full(6, 100), np.full(6, 101)), data=data, noise=Isotropic(0.1)))
    (motion,) = refusal(graph, values).free  # their sum alone is told
    assert motion.directions == 1 and (motion.keys == [100, 101]).all()


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


class _Step(Factor):
    """A position and a bias lead to the next ones together, as a combined IMU factor's states do."""

    variables = (2, 2, 2, 2)
    rows = 4

    @staticmethod
    def residual(x_i, b_i, x_j, b_j):
        return np.concatenate([x_j - x_i - b_i - 0.1 * b_j, b_j - b_i + 0.1 * (x_j - x_i)], axis=1)


def _steps(n, anchors):
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(n), np.zeros((n, 2)))
    values.insert(1000 + np.arange(n), np.zeros((n, 2)))
    i = np.arange(n - 1)
    graph.add(_Step((i, 1000 + i, i + 1, 1001 + i), noise=Isotropic(1.0)))
    for key in anchors:
        graph.add(Prior(key, [0.0, 0.0], Isotropic(1.0)))
    return graph, values


@pytest.mark.parametrize(("anchors", "free"), [([0, 1000], 0), ([0, 150], 0), ([150], 2), ([], 4)])
def test_states_that_follow_together_need_no_seed_of_their_own(anchors, free):
    graph, values = _steps(200, anchors)
    problem = Problem(graph, values)
    problem.linearize()
    found = inspect(problem)  # nothing is factorised
    assert found.complete
    assert sum(motion.scalars for motion in found.free) == free == nullity(graph, values)


def test_a_solve_looks_for_free_motions_once(monkeypatch):
    searches = []
    monkeypatch.setattr(diagnosis._Search, "run", _counted(diagnosis._Search.run, searches))
    graph, values = _steps(50, [0, 1000])
    graph.add(Prior(49, [1.0, 1.0], Isotropic(1.0)))
    assert solve(graph, values).status == "converged"
    assert len(searches) == 1


def _counted(method, calls):
    def counted(self, **options):
        calls.append(options)
        return method(self, **options)

    return counted
