"""Which start is used: the given one where it serves, the chordal one where it does not, and the record says so."""

import numpy as np
import pytest

from heliograph.graph import Between, Diagonal, FactorGraph, Huber, Values, read_pose_graph, solve
from heliograph.lie import SE2, SE3


def _ring(group, rng, n=40, turn=0.02):
    """Return a graph of a ring of poses with loops across it, its true values, and odometry as a start."""
    step = np.zeros((n, group.dof))
    step[:, 0 if group is SE2 else 2] = 2.0 * np.pi / n
    step[:, -2] = 1.0
    T = [group.identity()]
    for d in step[:-1]:
        T.append(T[-1].retract(d))
    T = group(np.stack([pose.matrix for pose in T]))
    i = np.concatenate([np.arange(n), np.arange(n // 2)])
    j = np.concatenate([(np.arange(n) + 1) % n, np.arange(n // 2) + n // 2])
    sigmas = np.full(group.dof, 0.05)
    sigmas[: group.dof // 2] = turn
    Z = (T[i].inverse() @ T[j]).retract(sigmas * rng.normal(size=(len(i), group.dof)))
    graph = FactorGraph()
    graph.add(Between(i, j, Z, Diagonal(sigmas)))
    graph.fix(0)
    return graph, T


def _values(T):
    values = Values()
    values.insert(np.arange(len(T)), T)
    return values


@pytest.mark.parametrize("group", [SE2, SE3])
def test_good_start_is_kept(group, rng):
    graph, T = _ring(group, rng)
    solution = solve(graph, _values(T))
    assert solution.start == "given"
    assert solution.chi2 < solution.initial_chi2


@pytest.mark.parametrize("group", [SE2, SE3])
def test_start_with_rotations_far_off_is_replaced_and_said_so(group, rng):
    graph, T = _ring(group, rng)
    best = solve(graph, _values(T))
    scrambled = _values(
        T.retract(np.where(np.arange(group.dof) < group.dof // 2, 1.5, 3.0) * rng.normal(size=(40, group.dof)))
    )
    scrambled.update(0, T[0])
    solution = solve(graph, scrambled)
    assert solution.start.startswith("chordal (the given one has")
    assert f"{solution.initial_chi2:.6g} as given" in solution.start
    assert solution.chi2 == pytest.approx(best.chi2, rel=1e-4)
    assert solve(graph, scrambled, initial="given").start == "given"


def test_chordal_start_is_refused_where_it_costs_more(rng):
    graph, T = _ring(SE2, rng)
    # One relative rotation is a mistake that a kernel bears; the chordal start knows no kernels.
    graph.add(
        Between(
            np.arange(5),
            np.arange(5) + 20,
            SE2.exp(np.tile([1.0, 0.0, 0.0], (5, 1))),
            Diagonal([0.001] * 3),
            kernel=Huber(0.1),
        )
    )
    solution = solve(graph, _values(T))
    assert solution.start.startswith("given (")
    assert "costs less" in solution.start


def test_end_in_a_wrong_valley_is_left_for_the_chordal_start(rng):
    graph, T = _ring(SE2, rng)
    # A ring wound once too often: no single rotation is far off, and every step is a little wrong.
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    wound = SE2.exp(np.stack([-angle, 0.0 * angle, 0.0 * angle], axis=1)) @ T
    values = _values(SE2(wound.matrix))
    values.update(0, T[0])
    best = solve(graph, _values(T))
    graph_alone = FactorGraph()
    chain = next(iter(graph))
    graph_alone.add(Between(np.arange(40), (np.arange(40) + 1) % 40, SE2(_opened(chain)), Diagonal([0.02, 0.05, 0.05])))
    graph_alone.fix(0)
    stuck = solve(graph_alone, values, initial="given")
    free = solve(graph_alone, values)
    assert stuck.chi2 > 100.0 * free.chi2
    assert free.start.startswith("chordal, after the given one")
    assert free.chi2 < best.chi2


def _opened(record):
    measured = record.measurement[:40]
    out = np.tile(np.eye(3), (40, 1, 1))
    out[:, 0, 0] = out[:, 1, 1] = measured[:, 0]
    out[:, 1, 0], out[:, 0, 1] = measured[:, 1], -measured[:, 1]
    out[:, :2, 2] = measured[:, 2:]
    return out


@pytest.mark.parametrize(
    ("name", "optimum", "chordal"),
    [
        ("torus3D", 24235.3, True),
        ("sphere_bignoise_vertex3", 2.98834e6, True),
        ("smallGrid3D", 1035.85, True),
        ("M3500", 137.915, False),
        ("intel", 45.0042, False),
        ("kitti_00", 98.3221, False),
        ("sphere2500", 1351.40, True),
        ("parking-garage", 1.26838, False),
    ],
)
def test_public_pose_graphs_reach_their_optima_without_options(shared_data, name, optimum, chordal):
    file = read_pose_graph(shared_data / "posegraphs" / f"{name}.g2o")
    starts = [file.odometry_values()] + ([] if len(file.missing_ids) else [file.values()])
    for values in starts:
        solution = solve(file.graph(), values)
        assert solution.status == "converged"
        assert solution.chi2 <= optimum * (1.0 + 1e-4)
        assert solution.start.startswith("chordal") == chordal
