"""A user's own factor whose variables may be of several families: solved, marginalised, written and read."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    ISAM2,
    Factor,
    FactorGraph,
    Isotropic,
    Marginals,
    Prior,
    Values,
    load_graph,
    save_graph,
    solve,
)
from heliograph.lie import SE2, SE3, ExtendedPose
from heliograph.testing import assert_factor


class Place(Factor):
    """A position, of whatever has one in space; derivatives are found by themselves."""

    variables = ((SE3, ExtendedPose),)
    rows = 3

    @staticmethod
    def residual(body, measured):
        return body[:, :3, 3] - measured


class Height(Place):
    """The same with derivatives that fit the family."""

    rows = 1

    @staticmethod
    def residual(body, measured):
        return body[:, 2, 3:4] - measured

    @staticmethod
    def jacobians(body, _measured):
        J = np.zeros((len(body), 1, 6 if body.shape[-1] == 4 else 9))
        J[:, 0, 3:6] = body[:, 2, :3]
        return (J,)


def small(rng):
    graph, values = FactorGraph(), Values()
    start = {0: SE3.exp(rng.normal(size=6)), 1: ExtendedPose.exp(rng.normal(size=9))}
    for key, value in start.items():
        values.insert(key, value)
        graph.add(Prior(key, value, Isotropic(10.0)))
    graph.add(Place([0, 1], data=(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),), noise=Isotropic(1e-3)))
    graph.add(Height(1, data=(6.0,), noise=Isotropic(1e-3)))
    return graph, values


def test_both_families_obey_the_law(rng):
    assert_factor(Place, rng, lambda rng, count: [rng.normal(size=(count, 3))])
    assert_factor(Height, rng, lambda rng, count: [rng.normal(size=(count, 1))])


def test_a_jacobian_for_one_family_only_is_caught(rng):
    body = {"jacobians": staticmethod(lambda body, _measured: (np.zeros((len(body), 1, 6)),))}
    with pytest.raises(AssertionError):
        assert_factor(type("Mutant", (Height,), body), rng, lambda rng, count: [rng.normal(size=(count, 1))])


def test_batch_and_increments_find_the_places(rng, tmp_path):
    graph, values = small(rng)
    found = solve(graph, values).values
    np.testing.assert_allclose(found.at(0).translation, [1.0, 2.0, 3.0], atol=1e-4)
    np.testing.assert_allclose(found.at(1).position, [4.0, 5.0, 6.0], atol=1e-4)
    assert Marginals(graph, found).covariance(0).shape == (6, 6)
    smoother = ISAM2()
    smoother.update(graph, values)
    smoother.save(tmp_path / "state.npz")
    smoother = ISAM2.load(tmp_path / "state.npz", factors=[Place, Height])
    smoother.update(iterate=1e-9)
    np.testing.assert_allclose(smoother.estimate(1).position, [4.0, 5.0, 6.0], atol=1e-4)
    other = type("Place", (Factor,), {"variables": (SE2,), "rows": 3, "residual": staticmethod(Place.residual)})
    with pytest.raises(GraphError, match="SE2"):
        ISAM2.load(tmp_path / "state.npz", factors=[other, Height])


def test_archives_keep_the_families(rng, tmp_path):
    graph, values = small(rng)
    save_graph(tmp_path / "graph.npz", graph, values)
    read, _ = load_graph(tmp_path / "graph.npz", factors=[Place, Height])
    assert [record.allowed for record in read] == [record.allowed for record in graph]
    other = type("Place", (Factor,), {"variables": (SE3,), "rows": 3, "residual": staticmethod(Place.residual)})
    with pytest.raises(GraphError, match="was saved with"):
        load_graph(tmp_path / "graph.npz", factors=[other, Height])


def test_another_family_is_refused(rng):
    graph, values = FactorGraph(), Values()
    values.insert(0, SE2.identity())
    graph.add(Place(0, data=(np.zeros(3),), noise=Isotropic(1.0)))
    with pytest.raises(GraphError, match="SE3 or ExtendedPose"):
        solve(graph, values)
