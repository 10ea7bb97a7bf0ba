"""Factors and values that are added one by one: what they are is what arrays of them are."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    Between,
    Cauchy,
    Covariance,
    Diagonal,
    FactorGraph,
    Information,
    Isotropic,
    Prior,
    Values,
    load_graph,
    save_graph,
    solve,
)
from heliograph.graph.model.families import stacked
from heliograph.graph.model.subgraph import split
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose

FAMILIES = (SO2, SO3, SE2, SE3, ExtendedPose)


def drawn(lie, rng, count):
    return lie.exp(rng.normal(size=(count, lie.dof)))


@pytest.mark.parametrize("lie", FAMILIES)
def test_single_factors_are_what_many_at_once_are(lie, rng):
    Z, noise = drawn(lie, rng, 5), Diagonal(rng.uniform(0.1, 1.0, lie.dof))
    together = Between(np.arange(5), np.arange(1, 6), Z, noise)
    for k in range(5):
        one = Between(k, k + 1, Z[k], noise)
        assert len(one) == 1 and one.arity == 2 and one.width == together.width
        np.testing.assert_array_equal(one.keys, together.keys[k : k + 1])
        np.testing.assert_array_equal(one.measurement, together.measurement[k : k + 1])
        assert one.allowed == together.allowed and one.rows == together.rows
        assert not one.keys.flags.writeable and not one.measurement.flags.writeable


def loop(lie, rng, together):
    """A loop of poses, its factors added one by one or all at once."""
    n, graph, values = 12, FactorGraph(), Values()
    X, step = drawn(lie, rng, n), drawn(lie, rng, n)
    noise, kernel = Diagonal(rng.uniform(0.1, 1.0, lie.dof)), Cauchy(1.0)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    if together:
        graph.add(Between(i, j, step, noise, kernel=kernel))
        graph.add(Prior([0], X[:1], noise))
        values.insert(i, X)
        return graph, values
    for k in range(n):
        assert graph.add(Between(k, (k + 1) % n, step[k], noise, kernel=kernel)) == range(k, k + 1)
        values.insert(k, X[k])
    graph.add(Prior(0, X[0], noise))
    return graph, values


@pytest.mark.parametrize("lie", FAMILIES)
def test_solutions_have_the_same_bits(lie, tmp_path):
    found = []
    for together in (True, False):
        graph, values = loop(lie, np.random.default_rng(3), together)
        found.append(solve(graph, values, initial="given").values.packed()[0])
        save_graph(tmp_path / "graph.npz", graph, values)
        found.append(solve(*load_graph(tmp_path / "graph.npz"), initial="given").values.packed()[0])
        part = next(iter(split(graph, np.zeros(len(graph), dtype=np.int64), 1)))
        found.append(solve(part, values, initial="given").values.packed()[0])
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize("value", [SE2.identity(), SE3.identity(), S2([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(16)])
def test_single_values_are_what_batches_are(value):
    one, many = Values(), Values()
    elements = stacked(value)[0]
    batch = elements if isinstance(value, np.ndarray) else type(value)(elements)
    one.insert(7, value)
    many.insert([7], batch)
    np.testing.assert_array_equal(one.packed()[0], many.packed()[0])
    np.testing.assert_array_equal(one.keys(), many.keys())
    assert one.families() == many.families()
    with pytest.raises(GraphError, match="key 7 is used twice"):
        one.insert(7, value)


def off(matrix, row, column, number):
    changed = np.array(matrix)
    changed[row, column] = number
    return changed


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        (SE3(off(np.eye(4), 0, 3, np.nan)), "not finite"),
        (SE3(off(np.eye(4), 0, 0, 1.1)), "no value of SE3"),
        (SE3(np.diag([1.0, 1.0, -1.0, 1.0])), "no value of SE3"),
        (ExtendedPose(off(np.eye(5), 2, 4, np.inf)), "not finite"),
        (SE2(off(np.eye(3), 0, 1, 0.2)), "no value of SE2"),
        (SO2(off(np.eye(2), 0, 1, np.nan)), "not finite"),
        (np.array([0.0, np.nan]), "not finite"),
    ],
)
def test_single_values_that_are_none_are_refused_by_name(value, fault):
    with pytest.raises(GraphError, match=f"key 3: .*{fault}"):
        Values().insert(3, value)
    if isinstance(value, (SE3, ExtendedPose)):
        with pytest.raises(GraphError, match=r"factor 0 \(keys 3, 4\): the measurement of Between"):
            FactorGraph().add(Between(3, 4, value, Isotropic(1.0)))


def test_single_factors_are_checked_as_many_are():
    graph, Z, noise = FactorGraph(), SE2.identity(), Isotropic(0.1)
    with pytest.raises(GraphError, match="joins a variable with itself"):
        graph.add(Between(3, 3, Z, noise))
    with pytest.raises(GraphError, match="needs 3 numbers a factor"):
        graph.add(Between(3, 4, Z, Diagonal([1.0, 2.0])))
    with pytest.raises(GraphError, match="must be positive"):
        graph.add(Between(3, 4, Z, Isotropic(0.0)))
    with pytest.raises(GraphError, match="must be positive"):
        graph.add(Between(3, 4, Z, Diagonal([1.0, -1.0, 1.0])))
    with pytest.raises(GraphError, match="not finite"):
        graph.add(Between(3, 4, Z, Isotropic(np.nan)))
    with pytest.raises(GraphError, match="positive definite"):
        graph.add(Between(3, 4, Z, Covariance(np.diag([1.0, 1.0, -1.0]) + 1e-3)))
    with pytest.raises(GraphError, match="does not fit in 64 bits"):
        Between(3, 1 << 63, Z, noise)
    with pytest.raises(GraphError, match="keys are integers"):
        Between(3, 4.0, Z, noise)
    with pytest.raises(GraphError, match="its noise is a float"):
        Between(3, 4, Z, 0.1)
    with pytest.raises(GraphError, match="directions have no difference"):
        Between(3, 4, S2([0.0, 0.0, 1.0]), Isotropic(1.0))
    assert len(graph) == 0


@pytest.mark.parametrize("rows", [1, 3, 6, 15, 70])
def test_covariance_root_is_that_of_its_inverse(rows, rng):
    A = rng.normal(size=(4, rows, rows)) * np.logspace(-4, 4, rows)[:, None]
    P = A @ np.swapaxes(A, 1, 2) + np.diag(np.logspace(-8, 8, rows))
    S = Covariance(P).sqrt_information(rows, 4).reshape(4, rows, rows)
    np.testing.assert_array_equal(S, np.triu(S))
    scale = np.sqrt(np.einsum("nii->ni", P))
    unit = P / (scale[:, :, None] * scale[:, None, :])
    scaled = S * scale[:, None, :]
    np.testing.assert_allclose(scaled @ unit @ np.swapaxes(scaled, 1, 2), np.tile(np.eye(rows), (4, 1, 1)), atol=1e-8)


def test_noise_is_prepared_the_same_for_one_as_for_many(rng):
    A = rng.normal(size=(3, 3))
    for noise in (
        Isotropic(0.3),
        Diagonal([0.1, 0.2, 0.3]),
        Diagonal([0.2] * 3),
        Covariance(A @ A.T),
        Information(A @ A.T),
    ):
        fast, slow = noise.ready(3), noise.whitening(3, 1)
        if fast is None:
            continue
        assert (fast.form, fast.shared) == (slow.form, slow.shared)
        np.testing.assert_array_equal(fast.sqrt_information, slow.sqrt_information)
