"""Poses from relative poses alone."""

import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.graph.files.odometry_start import odometry_start
from heliograph.lie import SE2, SE3
from reference.spanning import spanning_start as reference


def random_graph(rng, group, n=60, m=90):
    i, j = rng.integers(0, n, m), rng.integers(0, n, m)
    chain = rng.permutation(n - 1)[: n // 2]
    i, j = np.concatenate([i, chain]), np.concatenate([j, chain + 1])
    flip = rng.random(len(i)) < 0.5
    i, j = np.where(flip, j, i), np.where(flip, i, j)
    keep = i != j
    return i[keep], j[keep], group.exp(rng.normal(size=(keep.sum(), group.dof)))


@pytest.mark.parametrize("group", [SE2, SE3])
def test_start_is_that_of_the_reference(rng, group):
    for _ in range(20):
        i, j, Z = random_graph(rng, group, m=int(rng.integers(5, 90)))
        start = odometry_start(i, j, Z, np.arange(60))
        T, root, parent = reference(60, i, j, Z.matrix)
        assert (start.root == root).all()
        assert (start.parent == parent).all()
        np.testing.assert_allclose(start.matrices, T, atol=1e-9)


def test_first_of_parallel_edges_and_either_direction_count():
    Z = SE2.exp([[0.0, 1.0, 0.0], [0.0, 9.0, 0.0], [0.0, -2.0, 0.0]])
    start = odometry_start([10, 10, 30], [20, 20, 20], Z)
    assert start.ids.tolist() == [10, 20, 30]
    np.testing.assert_allclose(start.matrices[:, 0, 2], [0.0, 1.0, 3.0])


def test_odometry_goes_before_a_shorter_way():
    # 0-1-2-3 along odometry although an edge 0-3 would reach pose 3 at once.
    Z = SE2.exp([[0.0, 5.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    start = odometry_start([0, 0, 1, 2], [3, 1, 2, 3], Z)
    np.testing.assert_allclose(start.matrices[:, 0, 2], [0.0, 1.0, 2.0, 3.0])


def test_each_component_has_its_own_origin():
    start = odometry_start([5, 1], [7, 2], SE2.exp([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]), [9])
    assert start.ids.tolist() == [1, 2, 5, 7, 9]
    assert start.root.tolist() == [1, 1, 5, 5, 9]
    np.testing.assert_allclose(start.matrices[:, 0, 2], [0.0, 2.0, 0.0, 1.0, 0.0])


def test_long_chain_stays_on_the_group(rng):
    n = 200_000
    step = SE3.exp(rng.normal(size=(n, 6)))
    start = odometry_start(np.arange(n), np.arange(1, n + 1), step)
    R = start.matrices[-1, :3, :3]
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14


def test_numbers_must_fit():
    with pytest.raises(DataError, match="2 ids i, 1 ids j and 1 relative poses"):
        odometry_start([0, 1], [1], SE2.identity((1,)))
