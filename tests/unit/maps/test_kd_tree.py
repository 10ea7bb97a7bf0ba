"""The static k-d tree: exact neighbours, in a fixed order, of any points."""

import numpy as np
import pytest

from heliograph import _core


def _brute(points, query, count, reach):
    square = ((points - query) ** 2).sum(axis=1, dtype=np.float32)
    order = np.lexsort((np.arange(len(points)), square))
    return [int(i) for i in order if square[i] <= reach**2][:count]


@pytest.mark.parametrize("count", [1, 5, 40])
@pytest.mark.parametrize("size", [1, 7, 8, 9, 500])
def test_neighbours_agree_with_brute_force(size, count):
    rng = np.random.default_rng(size)
    points = rng.integers(-4, 5, (size, 3)).astype(np.float32)  # on a grid: many equal distances, many equal points
    tree = _core.KdTree(points)
    queries = np.concatenate([points[:20], rng.uniform(-6, 6, (40, 3)).astype(np.float32)])
    square, index = tree.nearest(queries, count, 3.0)
    for q, s, i in zip(queries, square, index, strict=True):
        wanted = _brute(points, q, count, 3.0)
        found = i[i >= 0].tolist()
        assert found == wanted
        assert np.isinf(s[len(found) :]).all()


def test_tree_of_nothing_and_of_nan():
    queries = np.zeros((2, 3), np.float32)
    for points in (np.zeros((0, 3), np.float32), np.full((4, 3), np.nan, np.float32)):
        tree = _core.KdTree(points)
        assert len(tree) == 0
        assert (tree.nearest(queries, 3, 10.0)[1] == -1).all()
    tree = _core.KdTree(np.float32([[np.nan, 0, 0], [1, 1, 1], [np.inf, 0, 0]]))
    assert len(tree) == 1
    assert tree.nearest(queries, 2, 10.0)[1][0].tolist() == [1, -1]
