"""Measurements of a part of a motion: poses and rotations of extended poses, chosen rows; and bearing with range."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    ISAM2,
    Bearing,
    BearingRange,
    Between,
    Diagonal,
    FactorGraph,
    Isotropic,
    PartialPrior,
    Position,
    Prior,
    Range,
    Values,
    load_graph,
    save_graph,
    solve,
    solve_robust,
)
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose
from native_records import assert_record

COUNT, KEYS = 5, np.arange(5)
HOLDERS = {SO3: 3, SE3: 4, ExtendedPose: 5}
ONE = Isotropic(1.0)


def drawn(lie, rng, scale=4.0):
    """Elements turned by up to 3 rad."""
    d = rng.normal(scale=scale, size=(COUNT, lie.dof))
    turns = 1 if lie in (SO2, SE2) else 3
    size = np.linalg.norm(d[:, :turns], axis=1, keepdims=True)
    d[:, :turns] *= rng.uniform(0.0, 3.0, size=(COUNT, 1)) / size
    return lie.exp(d)


def embedded(lie, X):
    """The leading part of a matrix that is an element of `lie`."""
    return X[: HOLDERS[lie], : HOLDERS[lie]]


@pytest.mark.parametrize(("measured", "holder"), [(SE3, ExtendedPose), (SO3, ExtendedPose), (SO3, SE3)])
def test_prior_of_a_part_is_the_parts_logarithm(measured, holder, rng):
    Z = drawn(measured, rng)
    # Turned by up to 2 rad from the measurement: the stencil of the twin must not cross half a turn.
    X = holder.exp(np.zeros((COUNT, holder.dof))).matrix.copy()
    X[:, :3, :3] = Z.matrix[:, :3, :3] @ SO3.exp(rng.normal(scale=0.8, size=(COUNT, 3))).matrix
    X[:, :3, 3:] += rng.normal(scale=5.0, size=X[:, :3, 3:].shape)

    def twin(k, X):
        return measured.ops.log(measured.ops.inverse(Z.matrix[k]) @ embedded(measured, X))

    assert_record(Prior(KEYS, Z, ONE), [holder(X)], twin)


@pytest.mark.parametrize(
    ("measured", "first", "second"),
    [
        (SE3, ExtendedPose, ExtendedPose),
        (SE3, SE3, ExtendedPose),
        (SE3, ExtendedPose, SE3),
        (SO3, ExtendedPose, ExtendedPose),
        (SO3, SE3, SE3),
        (SO3, SE3, ExtendedPose),
        (SO3, ExtendedPose, SE3),
    ],
)
def test_between_of_parts_is_the_parts_logarithm(measured, first, second, rng):
    X_i, X_j = drawn(first, rng), drawn(second, rng)
    relative = measured(
        np.stack(
            [
                measured.ops.inverse(embedded(measured, a)) @ embedded(measured, b)
                for a, b in zip(X_i.matrix, X_j.matrix, strict=True)
            ]
        )
    )
    Z = relative.retract(rng.normal(scale=0.8, size=(COUNT, measured.dof)))

    def twin(k, a, b):
        D = measured.ops.inverse(embedded(measured, a)) @ embedded(measured, b)
        return measured.ops.log(measured.ops.inverse(Z.matrix[k]) @ D)

    assert_record(Between(KEYS, 10 + KEYS, Z, ONE), [X_i, X_j], twin)


@pytest.mark.parametrize(
    ("lie", "rows"),
    [
        (ExtendedPose, [2]),
        (ExtendedPose, [0, 1, 8]),
        (ExtendedPose, list(range(9))),
        (SE3, [2, 5]),
        (SE2, [0]),
        (SE2, [1, 2]),
        (SO3, [0, 1]),
        (SO2, [0]),
    ],
)
def test_partial_prior_is_chosen_rows_of_a_prior(lie, rows, rng):
    Z = drawn(lie, rng)
    X = Z.retract(rng.normal(scale=0.8, size=(COUNT, lie.dof)))
    whole = Prior(KEYS, Z, ONE).evaluate(X)
    residual, (J,) = PartialPrior(KEYS, Z, rows, ONE).evaluate(X)
    np.testing.assert_allclose(residual, whole[0][:, rows], rtol=0, atol=1e-13)
    np.testing.assert_allclose(J, whole[1][0][:, rows], rtol=0, atol=1e-12)


def test_partial_prior_of_vectors_and_directions(rng):
    z, x = rng.normal(size=(2, COUNT, 7))
    residual, (J,) = PartialPrior(KEYS, z, [1, 6], ONE).evaluate(x)
    np.testing.assert_allclose(residual, (x - z)[:, [1, 6]])
    np.testing.assert_array_equal(J, np.tile(np.eye(7)[[1, 6]], (COUNT, 1, 1)))
    d, seen = S2(rng.normal(size=(COUNT, 3))), S2(rng.normal(size=(COUNT, 3)))
    whole = Prior(KEYS, d, ONE).evaluate(seen)
    found = PartialPrior(KEYS, d, [1], ONE).evaluate(seen)
    np.testing.assert_allclose(found[0], whole[0][:, [1]], atol=1e-14)
    np.testing.assert_allclose(found[1][0], whole[1][0][:, [1]], atol=1e-14)


@pytest.mark.parametrize("rows", [[], [1, 0], [0, 0], [-1], [6], [0, 6]])
def test_rows_that_there_are_not_are_refused(rows):
    with pytest.raises(GraphError, match="ascending numbers of 0 to 5"):
        PartialPrior(0, SE3.identity(), rows, ONE)


@pytest.mark.parametrize(
    ("lie", "target", "space"),
    [(SE2, 2, 2), (SE2, SE2, 2), (SE3, 3, 3), (SE3, ExtendedPose, 3), (ExtendedPose, 3, 3), (ExtendedPose, SE3, 3)],
)
def test_bearing_range_is_bearing_and_range(lie, target, space, rng):
    X = drawn(lie, rng)
    p = rng.normal(scale=4.0, size=(COUNT, space)) if isinstance(target, int) else drawn(target, rng)
    z = SO2.exp(rng.normal(size=(COUNT, 1))) if space == 2 else S2(rng.normal(size=(COUNT, 3)))
    length = rng.uniform(0.0, 9.0, COUNT)
    both = BearingRange(KEYS, 10 + KEYS, z, length, ONE).evaluate(X, p)
    parts = [Bearing(KEYS, 10 + KEYS, z, ONE).evaluate(X, p), Range(KEYS, 10 + KEYS, length, ONE).evaluate(X, p)]
    np.testing.assert_allclose(both[0], np.hstack([part[0] for part in parts]), rtol=0, atol=1e-13)
    for a in range(2):
        np.testing.assert_allclose(both[1][a], np.concatenate([part[1][a] for part in parts], axis=1), atol=1e-12)


def test_bearing_range_refuses_what_is_no_measurement():
    graph = FactorGraph()
    with pytest.raises(GraphError, match="is impossible"):
        graph.add(BearingRange(0, 1, SO2.identity(), -1.0, ONE))
    with pytest.raises(GraphError, match="a direction is an SO2"):
        BearingRange(0, 1, SE2.identity(), 1.0, ONE)


def test_families_that_do_not_fit_are_named():
    with pytest.raises(GraphError, match="Between needs SE3 or ExtendedPose, SE3 or ExtendedPose, but"):
        Between(0, 1, SE3.identity(), ONE).evaluate(SE2.identity(), SE2.identity())
    with pytest.raises(GraphError, match="two rotations or two poses"):
        Between(0, 1, SO3.identity(), ONE).evaluate(SO3.identity(), SE3.identity())
    with pytest.raises(GraphError, match="Prior needs ExtendedPose, but"):
        Prior(0, ExtendedPose.identity(), ONE).evaluate(SE3.identity())


def chain(rng):
    """Extended poses joined by relative poses, the velocity of each, and a loop: all that a front end measures."""
    step = SE3.exp([0.02, -0.01, 0.2, 1.0, 0.1, -0.05])
    X = [ExtendedPose.exp(rng.normal(size=9))]
    for _ in range(9):
        pose = X[-1].matrix[:4, :4] @ step.matrix
        X.append(ExtendedPose.from_rotation_position_velocity(pose[:3, :3], pose[:3, 3], rng.normal(size=3)))
    graph, values = FactorGraph(), Values()
    graph.add(Prior(0, SE3(X[0].matrix[:4, :4]), Diagonal([0.01] * 3 + [0.1] * 3)))
    graph.add(Between(np.arange(9), np.arange(1, 10), step, Diagonal([0.01] * 3 + [0.1] * 3)))
    far = SE3(np.linalg.solve(X[0].matrix[:4, :4], X[9].matrix[:4, :4]))
    graph.add(Between(0, 9, far, Isotropic(0.1)))
    truth = ExtendedPose(np.stack([x.matrix for x in X]))
    graph.add(PartialPrior(np.arange(10), truth, [6, 7, 8], Isotropic(0.1)))
    graph.add(Prior(4, SO3(truth[4].rotation), ONE))
    graph.add(Position(7, truth[7].position, ONE))
    values.insert(np.arange(10), truth.retract(rng.normal(scale=0.1, size=(10, 9))))
    return graph, values, truth


def test_relative_poses_and_partial_priors_determine_a_chain_of_states(rng):
    graph, values, truth = chain(rng)
    solution = solve(graph, values)
    assert solution.chi2 < 1e-12
    np.testing.assert_allclose(solution.values.at(np.arange(10)).matrix, truth.matrix, atol=1e-6)
    smoother = ISAM2()
    smoother.update(graph, values)
    smoother.update(iterate=1e-9)
    np.testing.assert_allclose(smoother.estimate(np.arange(10)).matrix, truth.matrix, atol=1e-6)


def test_such_graphs_are_written_and_read(rng, tmp_path):
    graph, values, _ = chain(rng)
    graph.add(BearingRange(0, 1, S2([1.0, 0.0, 0.0]), 1.0, Isotropic(10.0)))
    save_graph(tmp_path / "graph.npz", graph, values)
    read, _ = load_graph(tmp_path / "graph.npz")
    for before, after in zip(graph, read, strict=True):
        assert type(before) is type(after)
        np.testing.assert_array_equal(before.measurement, after.measurement)
    assert solve(read, values).chi2 == solve(graph, values).chi2


def ring(rng, count=20):
    """Poses around a circle with a loop; some turns are measured by a gyroscope as well."""
    step = SE3.exp([0.0, 0.0, 2 * np.pi / count, 1.0, 0.0, 0.0])
    truth = [np.eye(4)]
    for _ in range(count - 1):
        truth.append(truth[-1] @ step.matrix)
    X = SE3(np.stack(truth))
    i, j = np.arange(count), (np.arange(count) + 1) % count
    graph, values = FactorGraph(), Values()
    graph.fix(0)
    graph.add(Between(i, j, step, Diagonal([0.01] * 3 + [0.05] * 3)))
    graph.add(Between(i[::3], j[::3], SO3(step.matrix[:3, :3]), Isotropic(0.01)))
    graph.add(Prior(5, SO3(X.matrix[5, :3, :3]), Isotropic(0.01)))
    off = np.hstack([rng.normal(scale=1.2, size=(count, 3)), rng.normal(size=(count, 3))])
    off[0] = 0.0
    values.insert(i, X.retract(off))
    return graph, values, X


def test_linear_starts_and_robust_solving_pass_over_what_measures_a_part(rng):
    graph, values, X = ring(rng)
    for solution in (solve(graph, values, initial="chordal"), solve_robust(graph, values)):
        np.testing.assert_allclose(solution.values.at(np.arange(len(X))).matrix, X.matrix, atol=1e-5)
