"""Outliers are found and left out: random false loop closures, with what is true known."""

import numpy as np
import pytest

from heliograph.errors import ConfigError, GraphError
from heliograph.graph import (
    Between,
    Cauchy,
    Diagonal,
    FactorGraph,
    Information,
    Isotropic,
    Position,
    Prior,
    Range,
    RobustSettings,
    Values,
    read_pose_graph,
    solve,
    solve_robust,
)
from heliograph.graph.batch.chordal import whitened_information
from heliograph.graph.model.outliers import geman_mcclure_weight, truncated_weight
from heliograph.graph.model.subgraph import subgraph
from heliograph.lie import SE2, SE3


def test_surrogate_weights_have_their_limits():
    squared = np.array([0.0, 0.5, 0.999, 1.001, 2.0, 100.0])
    np.testing.assert_allclose(truncated_weight(squared, 1e6), [1, 1, 1, 0, 0, 0], atol=1e-3)
    np.testing.assert_allclose(geman_mcclure_weight(squared, 1.0), 1.0 / (1.0 + squared) ** 2)
    # Nearly convex: all count alike, and the weights fall with the residual.
    assert geman_mcclure_weight(squared, 1e9).min() > 0.999
    convex = truncated_weight(squared, 1.0 / (2.0 * 100.0 - 1.0))
    assert (convex > 0.0).all()
    assert (np.diff(convex) <= 0.0).all()
    # The weight is continuous where its branches meet.
    for mu in (0.01, 1.0, 7.0):
        for edge in (mu / (mu + 1.0), (mu + 1.0) / mu):
            below, above = truncated_weight(np.array([edge * (1 - 1e-9), edge * (1 + 1e-9)]), mu)
            assert below == pytest.approx(above, abs=1e-6)


def _with_false_loops(file, share, rng):
    """Return the graph of a file with false loop closures among the true ones, and the number of its own factors."""
    i, j, Z = file.edges
    graph = file.graph()
    own = len(graph)
    loops = np.flatnonzero(np.abs(i - j) != 1)
    count = round(len(loops) * share / (1.0 - share))
    a, b = rng.choice(file.pose_ids, (2, count))
    apart = np.abs(a - b) > 10
    a, b, pick = a[apart], b[apart], rng.choice(loops, count)[apart]
    group = graph.groups()[0]
    omega = whitened_information(group.whitening, group.record.rows, own)
    graph.add(Between(a, b, Z[pick], Information(omega[pick])))
    return graph, own


@pytest.mark.parametrize("name", ["M3500", pytest.param("sphere2500", marks=pytest.mark.slow)])
@pytest.mark.parametrize("share", [0.1, 0.5])
def test_inlier_solution_of_public_graphs_is_recovered(shared_data, name, share, rng):
    file = read_pose_graph(shared_data / "posegraphs" / f"{name}.g2o")
    graph, own = _with_false_loops(file, share, rng)
    clean = solve(file.graph(), file.odometry_values())
    found = solve_robust(graph, file.odometry_values())
    assert found.status == "converged"
    assert found.squared[:own].sum() == pytest.approx(clean.chi2, rel=1e-3)
    assert found.inliers[:own].all()
    assert found.inliers[own:].sum() <= 0.005 * (len(graph) - own)
    assert found.scale < 0.3


def _corridor(group, rng, n=60):
    """Return a graph of a walk that goes there and back, its loops every third pose, and odometry."""
    step = np.zeros((n, group.dof))
    step[:, -2 if group is SE2 else 3] = 1.0
    step[n // 2, 0 if group is SE2 else 2] = np.pi
    T = [group.identity().matrix]
    for d in step[:-1]:
        T.append(T[-1] @ group.exp(d).matrix)
    T = group(np.array(T))
    sigmas = np.full(group.dof, 0.05)
    sigmas[: group.dof // 2] = 0.01
    i, j = np.arange(n - 1), np.arange(1, n)
    back = np.arange(0, n // 2 - 1, 3)
    i, j = np.concatenate([i, back]), np.concatenate([j, n - back - 1])
    Z = (T[i].inverse() @ T[j]).retract(sigmas * rng.normal(size=(len(i), group.dof)))
    graph = FactorGraph()
    graph.add(Between(i, j, Z, Diagonal(sigmas)))
    graph.fix(0)
    values = Values()
    poses = [group.identity().matrix]
    for k in range(n - 1):
        poses.append(poses[-1] @ Z.matrix[k])
    values.insert(np.arange(n), group(np.array(poses)))
    return graph, values, T, sigmas


@pytest.mark.parametrize("group", [SE2, SE3])
@pytest.mark.parametrize("surrogate", ["tls", "gm"])
def test_false_loops_and_positions_are_told_with_honest_noise(group, surrogate, rng):
    graph, values, T, sigmas = _corridor(group, rng)
    own = len(graph)
    clean = solve(graph, values)
    a, b = np.array([3, 10, 20, 33]), np.array([40, 55, 45, 58])
    graph.add(Between(a, b, group.exp(rng.normal(size=(4, group.dof))), Diagonal(sigmas), kernel=Cauchy(1.0)))
    d = group.dof - (1 if group is SE2 else 3)
    graph.add(Position(30, T.matrix[30, :d, d] + 9.0, Isotropic(0.1)))
    trusted = np.zeros(len(graph), dtype=bool)
    trusted[:59] = True
    found = solve_robust(graph, values, trusted=trusted, settings=RobustSettings(surrogate=surrogate))
    np.testing.assert_array_equal(found.inliers[own:], False)
    assert found.inliers[:own].all()
    assert 0.3 < found.scale < 2.0
    assert found.chi2 == pytest.approx(clean.chi2, rel=1e-4)
    assert found.values.block(group)[1].matrix == pytest.approx(clean.values.block(group)[1].matrix, abs=1e-3)


def test_outliers_of_other_factors_are_found_too(rng):
    values, graph = Values(), FactorGraph()
    points = rng.uniform(-10.0, 10.0, (8, 2))
    values.insert(np.arange(8), points)
    values.insert(100, [1.0, 1.0])
    graph.add(Prior(np.arange(8), points, Isotropic(0.01)))
    graph.add(Prior(100, [1.0, 1.0], Isotropic(5.0)))
    truth = np.array([2.0, -1.0])
    distance = np.linalg.norm(points - truth, axis=1)
    distance[[2, 5, 6]] += [4.0, -1.5, 7.0]
    graph.add(Range(100, np.arange(8), distance.clip(0.0), Isotropic(0.05)))
    found = solve_robust(graph, values, trusted=np.arange(9))
    np.testing.assert_array_equal(np.flatnonzero(~found.inliers) - 9, [2, 5, 6])
    np.testing.assert_allclose(found.values.at(100), truth, atol=0.01)


def test_trusted_factors_must_exist(rng):
    graph, values, *_ = _corridor(SE2, rng)
    with pytest.raises(GraphError, match="the graph has 0 to"):
        solve_robust(graph, values, trusted=[0, 1000])
    with pytest.raises(GraphError, match="a mask of shape"):
        solve_robust(graph, values, trusted=np.ones(3, dtype=bool))
    with pytest.raises(ConfigError, match="surrogate"):
        RobustSettings(surrogate="huber")


def test_subgraph_keeps_rows_noise_and_numbers(rng):
    graph, values, _, _ = _corridor(SE2, rng)
    graph.add(Prior([3, 4], values.at([3, 4]), Isotropic([0.1, 0.2]), kernel=Cauchy(1.0)))
    chosen = rng.random(len(graph)) < 0.4
    chosen[-1] = True
    chosen[-2] = False
    part, numbers = subgraph(graph, chosen, np.ones(len(graph), dtype=bool))
    assert sorted(numbers.tolist()) == np.flatnonzero(chosen).tolist()
    for k, number in enumerate(numbers):
        (mine, a), (theirs, b) = part.factor(k), graph.factor(int(number))
        np.testing.assert_array_equal(mine.keys[a], theirs.keys[b])
        np.testing.assert_array_equal(mine.measurement[a], theirs.measurement[b])
        assert mine.kernel is None
    assert part.groups()[-1].whitening.sqrt_information.item() == 5.0
    np.testing.assert_array_equal(part.fixed, [0])
