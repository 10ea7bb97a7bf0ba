"""A graph joined to values: dense indices, groups, and what is missing."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    Between,
    Constrained,
    Diagonal,
    Factor,
    FactorGraph,
    Huber,
    Information,
    Isotropic,
    Prior,
    Range,
    Values,
)
from heliograph.graph.problem.resolve import gather, resolve, resolve_fixed
from heliograph.lie import SE2, SE3

NOISE = Isotropic(0.5)


class Difference(Factor):
    variables = (2, 2)
    rows = 2

    @staticmethod
    def residual(a, b, offset):
        return b - a - offset


@pytest.fixture
def values(rng):
    v = Values()
    v.insert([10, 11], rng.normal(size=(2, 2)))
    v.insert([0, 1, 2], SE2.exp(rng.normal(size=(3, 3))))
    v.insert(12, rng.normal(size=2))
    v.insert(50, SE3.identity())
    return v


def test_keys_become_dense_indices(values):
    graph = FactorGraph()
    graph.add(Between([2, 0], [1, 2], SE2.identity(), NOISE, kernel=Huber(1.3)))
    (group,) = resolve(graph, values)
    np.testing.assert_array_equal(group.variables, [[5, 4], [3, 5]])
    assert group.variables.dtype == np.int32 and group.variables.flags.c_contiguous
    assert (group.code, group.rows, group.kernel_code, group.kernel_width) == (2, 3, 1, 1.3)
    assert [f.name for f in group.families] == ["SE2", "SE2"] and group.custom is None
    assert group.noise.shared and group.noise.sqrt_information.tolist() == [[2.0]]
    first, second = gather(group, values.families(), values.packed())
    np.testing.assert_allclose(first, values.at([2, 0]).matrix, atol=1e-15)
    np.testing.assert_allclose(second, values.at([1, 2]).matrix, atol=1e-15)


def test_a_record_over_several_families_is_split(values):
    graph = FactorGraph()
    graph.add(Prior(50, SE3.identity(), NOISE))
    graph.add(Range([0, 10, 1, 11, 12], [1, 11, 10, 2, 10], [1.0, 2.0, 3.0, 4.0, 5.0], Isotropic([1, 2, 4, 5, 8.0])))
    groups = resolve(graph, values)[1:]
    found = {tuple(f.name for f in g.families): g for g in groups}
    assert len(found) == len(groups) == 4
    points = found["vectors of dimension 2", "vectors of dimension 2"]
    np.testing.assert_array_equal(points.numbers, [2, 5])
    np.testing.assert_array_equal(points.variables, [[0, 1], [2, 0]])
    np.testing.assert_array_equal(points.measurement, [[2.0], [5.0]])
    np.testing.assert_array_equal(points.noise.sqrt_information, [[0.5], [0.125]])
    mixed = found["vectors of dimension 2", "SE2"]
    np.testing.assert_array_equal(mixed.variables, [[1, 5]])
    assert sorted(np.concatenate([g.numbers for g in groups]).tolist()) == [1, 2, 3, 4, 5]


def test_factors_added_one_by_one_are_one_group(values):
    """A loop of single additions, mixed with others, costs the solver no more than one call."""
    one_by_one, at_once = FactorGraph(), FactorGraph()
    T = SE2.exp(np.arange(9.0).reshape(3, 3))
    sigmas = np.arange(1.0, 10.0).reshape(3, 3)
    for row, (i, j) in enumerate([(0, 1), (1, 2), (0, 2)]):
        one_by_one.add(Between(i, j, T[row], Diagonal(sigmas[row])))
        one_by_one.add(Range(i, 10, 1.0, NOISE))
    at_once.add(Between([0, 1, 0], [1, 2, 2], T, Diagonal(sigmas)))
    at_once.add(Range([0, 1, 0], 10, 1.0, NOISE))
    apart, together = resolve(one_by_one, values), resolve(at_once, values)
    assert len(apart) == len(together) == 2
    for a, b in zip(apart, together, strict=True):
        np.testing.assert_array_equal(a.variables, b.variables)
        np.testing.assert_array_equal(a.measurement, b.measurement)
        np.testing.assert_array_equal(a.noise.sqrt_information, b.noise.sqrt_information)
        assert a.noise.shared == b.noise.shared and a.noise.form == b.noise.form
    np.testing.assert_array_equal(apart[0].numbers, [0, 2, 4])
    np.testing.assert_array_equal(apart[1].numbers, [1, 3, 5])


def test_what_differs_is_kept_apart(values):
    graph = FactorGraph()
    for noise, kernel in (
        (NOISE, None),
        (Constrained(), None),
        (NOISE, Huber(1.0)),
        (NOISE, Huber(2.0)),
        (Diagonal([1.0, 2.0, 3.0]), None),
        (Information(np.eye(3) + 0.1), None),
    ):
        graph.add(Between(0, 1, SE2.identity(), noise, kernel=kernel))
    groups = resolve(graph, values)
    assert len(groups) == 6 and [g.constrained for g in groups] == [False, True, False, False, False, False]


def test_shared_and_own_noise_join(values):
    graph = FactorGraph()
    graph.add(Between([0, 1], [1, 2], SE2.identity(), NOISE))
    graph.add(Between([0, 1], [2, 0], SE2.identity(), Isotropic([1.0, 4.0])))
    (group,) = resolve(graph, values)
    assert not group.noise.shared and group.noise.sqrt_information.ravel().tolist() == [2.0, 2.0, 1.0, 0.25]


def test_own_factors_of_a_class_are_one_group(values):
    graph = FactorGraph()
    graph.add(Difference((10, 11), data=([1.0, 2.0],), noise=NOISE))
    graph.add(Difference(([10, 12], [12, 11]), data=(np.ones((2, 2)),), noise=NOISE))
    (group,) = resolve(graph, values)
    assert group.custom is Difference and group.code == 0
    arrays = gather(group, values.families(), values.packed())
    residual, (by_a, by_b) = group.custom.evaluate(arrays, group.data)
    expected = values.at([11, 12, 11]) - values.at([10, 10, 12]) - [[1.0, 2.0], [1.0, 1.0], [1.0, 1.0]]
    np.testing.assert_allclose(residual, expected, atol=1e-14)
    np.testing.assert_allclose(by_a, np.tile(-np.eye(2), (3, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(by_b, np.tile(np.eye(2), (3, 1, 1)), atol=1e-9)


def test_fixed_keys_become_dense_indices(values):
    graph = FactorGraph()
    graph.fix([2, 10])
    np.testing.assert_array_equal(resolve_fixed(graph, values), [0, 5])
    graph.fix(77)
    with pytest.raises(GraphError, match=r"key 77: held by `fix`, but without a value"):
        resolve_fixed(graph, values)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (
            lambda: Between([0, 1], [1, 77], SE2.identity(), NOISE),
            r"factor 2 \(keys 1, 77\): no value for key 77 ",
        ),
        (
            lambda: Between([0, 1], [1, 10], SE2.identity(), NOISE),
            r"factor 2 \(keys 1, 10\): Between needs SE2, SE2",
        ),
        (lambda: Between([0, 0], [1, 50], SE2.identity(), NOISE), r"factor 2 \(keys 0, 50\): .* SE2, SE3"),
        (lambda: Range([0, 0], [1, 50], 1.0, NOISE), r"factor 2 \(keys 0, 50\): Range needs two positions in the same"),
        (lambda: Difference((0, 10), data=([0.0, 0.0],), noise=NOISE), r"factor 1 \(keys 0, 10\): Difference needs"),
    ],
)
def test_missing_values_and_wrong_families_are_named(values, record, message):
    graph = FactorGraph()
    graph.add(Prior(0, SE2.identity(), NOISE))
    graph.add(record())
    with pytest.raises(GraphError, match=message):
        resolve(graph, values)


def test_an_empty_graph_has_no_groups(values):
    assert resolve(FactorGraph(), values) == []


def test_no_values_at_all_are_named():
    graph = FactorGraph()
    graph.add(Prior(3, SE2.identity(), NOISE))
    with pytest.raises(GraphError, match="no value for key 3"):
        resolve(graph, Values())
