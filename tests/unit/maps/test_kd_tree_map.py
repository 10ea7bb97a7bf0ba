"""The incremental k-d tree: the law of local maps, and exactness against brute force through any changes."""

import numpy as np
import pytest

from heliograph import _core
from heliograph.config import KdTreeMapConfig
from heliograph.errors import ConfigError, DataError
from heliograph.maps import KdTreeMap, LocalMap, WindowedMap
from heliograph.testing import assert_local_map


def test_kd_tree_map_obeys_the_law(rng):
    assert isinstance(KdTreeMap(), LocalMap) and isinstance(KdTreeMap(), WindowedMap)
    assert_local_map(KdTreeMap, rng)


def _assert_exact(tree, points, rng, count=7):
    assert len(tree) == len(points)
    assert sorted(map(tuple, tree.points())) == sorted(map(tuple, points))
    if len(points) == 0:
        return
    queries = np.concatenate([points[:: max(1, len(points) // 20)], rng.uniform(-30, 30, (20, 3))]).astype(np.float32)
    square, places = tree.nearest(queries, count, 1e6)
    for q, s, p in zip(queries, square, places, strict=True):
        d = points - q
        wanted = d[:, 0] ** 2 + d[:, 1] ** 2 + d[:, 2] ** 2
        order = np.lexsort((*points.T[::-1], wanted))[:count]
        np.testing.assert_array_equal(s[: len(order)], wanted[order])
        np.testing.assert_array_equal(p[: len(order)], points[order])


@pytest.mark.parametrize("grid", [False, True])
def test_tree_is_exact_through_insertions_and_removals(grid):
    rng = np.random.default_rng(11)
    tree, points = _core.IncrementalKdTree(0.0, 0.7), np.zeros((0, 3), np.float32)
    for step in range(40):
        if step % 4 < 2:
            centre = rng.uniform(-20, 20, 3)
            new = (centre + rng.normal(size=(int(rng.integers(1, 300)), 3)) * rng.uniform(0.1, 5)).astype(np.float32)
            new = np.round(new) if grid else new  # on a grid many points and coordinates are equal
            tree.insert(np.ascontiguousarray(new))
            points = np.concatenate([points, new])
        elif step % 4 == 2:
            low = rng.uniform(-20, 10, 3).astype(np.float32)
            high = (low + rng.uniform(1, 15, 3)).astype(np.float32)
            low, high = (np.round(low), np.round(high)) if grid else (low, high)
            gone = ((points >= low) & (points <= high)).all(axis=1)
            assert tree.remove_box(low, high) == gone.sum()
            points = points[~gone]
        elif step % 8 == 7:
            centre = rng.uniform(-3, 3, 3).astype(np.float32)
            d = points - centre
            gone = (d[:, 0] ** 2 + d[:, 1] ** 2 + d[:, 2] ** 2) > np.float32(18.0) ** 2
            assert tree.remove_beyond(centre, 18.0) == gone.sum()
            points = points[~gone]
        _assert_exact(tree, points, rng)


def test_tree_stays_shallow_where_points_come_in_order():
    tree = _core.IncrementalKdTree(0.0, 0.7)
    x = np.arange(40000, dtype=np.float32)
    for part in np.array_split(np.stack([x, 0 * x, 0 * x], axis=1), 40):
        tree.insert(np.ascontiguousarray(part))
    assert tree.depth() <= np.log(40000 / 16) / np.log(1 / 0.7) + 3


def test_one_point_a_cube_whatever_the_order():
    rng = np.random.default_rng(3)
    points = rng.uniform(-3, 3, (5000, 3)).astype(np.float32)
    trees = []
    for order in (np.arange(5000), rng.permutation(5000)):
        tree = _core.IncrementalKdTree(0.5, 0.7)
        for part in np.array_split(points[order], 7):
            tree.insert(np.ascontiguousarray(part))
        trees.append(tree)
    kept = [sorted(map(tuple, tree.points())) for tree in trees]
    assert kept[0] == kept[1]
    cubes = np.floor(np.array(kept[0]) / 0.5)
    assert len(np.unique(cubes, axis=0)) == len(cubes) == len(np.unique(np.floor(points / 0.5), axis=0))


def test_memory_stays_bounded_while_driving():
    rng = np.random.default_rng(5)
    some = KdTreeMap(KdTreeMapConfig(spacing=0.3, radius=30.0))
    sizes, T = [], np.eye(4)
    for x in np.arange(0.0, 600.0, 5.0):
        T[0, 3] = x
        some.insert(rng.uniform(-25, 25, (1500, 3)).astype(np.float32), T)
        some.prune(T[:3, 3])
        sizes.append(some.nbytes)
    assert max(sizes[40:]) <= 1.3 * max(sizes[20:40])


def test_prune_keeps_the_nearest_of_too_many():
    some = KdTreeMap(KdTreeMapConfig(spacing=0.0, max_points=1000))
    points = np.random.default_rng(0).uniform(-20, 20, (3000, 3)).astype(np.float32)
    some.insert(points, np.eye(4))
    some.prune(np.zeros(3))
    assert 990 <= len(some) <= 1000
    distance = np.sort(np.linalg.norm(points, axis=1))
    assert np.linalg.norm(some.points(), axis=1).max() <= distance[1000]


def test_kd_tree_map_does_not_depend_on_threads(rng):
    points = rng.uniform(-5, 5, (4000, 3)).astype(np.float32) * np.float32([1, 1, 0.01])
    found = []
    for threads in (1, 4):
        some = KdTreeMap(threads=threads)
        some.insert(points, np.eye(4))
        found.append(some.planes_at(points.astype(np.float64), gate=0.2))
    assert found[0].normal.tobytes() == found[1].normal.tobytes() and found[0].source.sum() > 0


def test_bad_boxes_and_settings_are_refused():
    with pytest.raises(DataError, match="box"):
        KdTreeMap().remove_box(np.ones(3), np.zeros(3))
    with pytest.raises(ConfigError, match="balance"):
        KdTreeMapConfig(balance=0.4)
