"""The map of features: means in cubes, lines and planes through them, pruning, against slow twins."""

import numpy as np
import pytest
from tests.reference.loam import SHIFT, match_slowly, means_slowly

from heliograph.config import LoamConfig
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.maps import FeatureMap, FeaturePoints

CONFIG = LoamConfig()
NONE = np.zeros((0, 3), np.float32)


def corner(rng, count=3000, noise=0.01):
    """Points of two walls and a floor, and of the upright line where the walls meet."""
    u, v = rng.uniform(0.0, 3.0, (2, count))
    side = rng.integers(0, 3, count)
    flat = (
        np.choose(side, [np.zeros(count), u, u]),
        np.choose(side, [u, np.zeros(count), v]),
        np.choose(side, [v, v, np.zeros(count)]),
    )
    planes = np.stack(flat, axis=1) + noise * rng.normal(size=(count, 3))
    line = np.stack([np.zeros(200), np.zeros(200), np.linspace(0.0, 3.0, 200)], axis=1) + noise * rng.normal(
        size=(200, 3)
    )
    return FeaturePoints(edges=line.astype(np.float32), planes=planes.astype(np.float32))


def test_means_equal_the_slow_twin():
    points = corner(np.random.default_rng(0))
    T = se3.exp(np.array([0.1, -0.2, 0.3, 4.0, -5.0, 6.0]))
    local_map = FeatureMap(CONFIG)
    assert local_map.insert(points, T) == 1.0
    for native, cloud, voxel in (
        (local_map.edges, points.edges, CONFIG.edge_voxel),
        (local_map.planes, points.planes, CONFIG.plane_voxel),
    ):
        q = cloud.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        expected = means_slowly(q, voxel, CONFIG.max_points)
        cells = native.cells()
        assert len(cells) == len(native) == len(expected)
        by_cube = {tuple(np.floor(mean / voxel + SHIFT).astype(int)): (mean, n) for mean, n in expected.values()}
        for x, y, z, count in cells:
            mean, n = by_cube[tuple(np.floor(np.array([x, y, z]) / voxel + SHIFT).astype(int))]
            assert count == n
            np.testing.assert_allclose([x, y, z], mean, atol=2e-6)


@pytest.mark.parametrize("edges", [True, False])
def test_lines_and_planes_equal_the_slow_twin(edges):
    rng = np.random.default_rng(1)
    points = corner(rng)
    local_map = FeatureMap(CONFIG)
    local_map.insert(points, np.eye(4))
    native = local_map.edges if edges else local_map.planes
    cells = {k: (row[:3], row[3]) for k, row in enumerate(native.cells())}
    queries = (points.edges[::9] if edges else points.planes[::25]) + np.float32(0.02)
    queries = np.concatenate([queries, np.float32([[90.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])])
    rows = native.match(queries, np.eye(4), 0.03, 2).table()
    c = CONFIG
    voxel, reach = (c.edge_voxel, c.edge_reach) if edges else (c.plane_voxel, c.plane_reach)
    found = 0
    for q, row in zip(queries[:-1].astype(np.float64), rows, strict=False):
        expected = match_slowly(
            cells, q, 0.03, edges=edges, neighbours=c.neighbours, reach=reach, max_thickness=c.max_thickness,
            min_spread=c.min_spread * voxel,
        )  # fmt: skip
        assert (expected is None) == (row[0] == 0.0)
        if expected is None:
            continue
        found += 1
        axis, centre, variance, tilt = expected
        assert abs(axis @ row[1:4]) == pytest.approx(1.0, abs=1e-6)
        np.testing.assert_allclose(row[4:7], centre, atol=1e-6)
        np.testing.assert_allclose(row[7:9], [variance, tilt], rtol=1e-4)
    assert found > 0.5 * len(queries)
    assert not rows[-2:, 0].any()


def test_known_ground_is_nothing_new_and_a_frozen_cube_stays():
    points = corner(np.random.default_rng(2))
    local_map = FeatureMap(CONFIG)
    assert local_map.insert(points, np.eye(4)) == 1.0
    assert local_map.insert(points, np.eye(4)) == 0.0
    aside = np.eye(4)
    aside[0, 3] = 1.0
    assert 0.1 < local_map.insert(points, aside) < 0.9
    for _ in range(20):
        local_map.insert(points, np.eye(4))
    before = local_map.planes.cells()
    full = before[:, 3] >= CONFIG.max_points
    local_map.insert(points, np.eye(4))
    assert full.any()
    np.testing.assert_array_equal(local_map.planes.cells()[full], before[full])


def test_pruning_forgets_what_is_far_or_too_much():
    points = corner(np.random.default_rng(3))
    local_map = FeatureMap(LoamConfig(max_cells=40), radius=2.0)
    local_map.insert(points, np.eye(4))
    local_map.prune(np.zeros(3))
    cells = local_map.planes.cells()
    assert len(cells) == 40
    everything = FeatureMap(CONFIG)
    everything.insert(points, np.eye(4))
    nearest = np.sort(np.linalg.norm(everything.planes.cells()[:, :3], axis=1))[:40]
    np.testing.assert_allclose(np.sort(np.linalg.norm(cells[:, :3], axis=1)), nearest)
    assert local_map.insert(points, np.eye(4)) > 0.0
    local_map.clear()
    assert len(local_map) == 0
    assert local_map.nbytes > 0


def test_wrong_arrays_are_refused():
    local_map = FeatureMap()
    with pytest.raises(DataError, match="edges"):
        FeaturePoints(edges=np.zeros((2, 3)), planes=NONE)
    with pytest.raises(DataError, match="T_odom_body"):
        local_map.insert(FeaturePoints(edges=NONE, planes=NONE), np.full((4, 4), np.nan))
    with pytest.raises(DataError, match="centre_odom"):
        local_map.prune(np.zeros(2))
    assert local_map.insert(FeaturePoints(edges=NONE, planes=NONE), np.eye(4)) == 0.0
