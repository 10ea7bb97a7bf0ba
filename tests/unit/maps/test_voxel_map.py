"""The voxel map against its twin, cube by cube."""

from dataclasses import replace

import numpy as np
import pytest

import states
from heliograph.config import MapConfig
from heliograph.maps import VoxelMap
from heliograph.testing import assert_local_map
from reference.maps import SlowVoxelMap
from reference.matching import find_slowly
from states import random_pose, wall

CONFIG = MapConfig(voxel=0.5, levels=3)


def room_cloud(rng, count, sigma=0.01):
    """A small room, so that few points fill its cubes."""
    return states.room_cloud(rng, count, half=1.5, sigma=sigma)


def filled(config, clouds, poses):
    fast, slow = VoxelMap(config), SlowVoxelMap(config)
    for cloud, T in zip(clouds, poses, strict=True):
        fast.insert(cloud, T)
        slow.insert(cloud, T)
    return fast, slow


def random_pair(rng, config=CONFIG, scans=3, points=1500):
    poses = [np.eye(4)] + [random_pose(rng, 0.2) for _ in range(scans - 1)]
    clouds = []
    for T in poses:
        world = room_cloud(rng, points)
        clouds.append(((world - T[:3, 3]) @ T[:3, :3]).astype(np.float32))
    return filled(config, clouds, poses)


def assert_same_cubes(fast, slow):
    table = fast.table()
    found = {
        (int(row[0]), tuple(np.floor(row[2:5] / slow.edge(int(row[0]))).astype(int).tolist())): row for row in table
    }
    assert found.keys() == slow.cubes.keys()
    assert len(fast) == len(slow.cubes)
    planes = 0
    for key, entry in slow.cubes.items():
        row, plane = found[key], entry["plane"]
        assert row[1] == len(entry["points"])
        np.testing.assert_allclose(row[2:5], slow.centre(key), atol=1e-9)
        assert (row[11] >= 0.0) == (plane is not None), f"cube {key}: {row}"
        if plane is None:
            continue
        planes += 1
        assert abs(row[5:8] @ plane["normal"]) == pytest.approx(1.0, abs=1e-4)
        assert np.linalg.norm(row[5:8]) == pytest.approx(1.0, abs=1e-6)
        np.testing.assert_allclose(row[8:11], plane["centroid"], atol=1e-5)
        assert row[11] == pytest.approx(plane["variance"], rel=2e-2, abs=2e-8)
        assert row[12] == pytest.approx(plane["inv_spread"], rel=1e-3)
    return planes


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, levels=1), replace(CONFIG, levels=5, voxel=0.2)])
def test_map_equals_its_twin(seed, config):
    assert assert_same_cubes(*random_pair(np.random.default_rng(seed), config)) > 50


def test_map_obeys_the_law(rng):
    assert_local_map(lambda: VoxelMap(MapConfig()), rng)


def test_full_cube_is_frozen(rng):
    config = replace(CONFIG, max_points=60, levels=1)
    cloud = wall(rng, [0.2, 0.1, 1.0], 0.3, 2000, half=1.0)
    fast, slow = filled(config, np.split(cloud, 4), [np.eye(4)] * 4)
    before = fast.table().copy()
    assert_same_cubes(fast, slow)
    raised = cloud + np.array([0.0, 0.0, 0.02], np.float32)
    fast.insert(raised, np.eye(4))
    frozen = before[:, 1] >= 60
    assert frozen.sum() > 10
    np.testing.assert_array_equal(fast.table()[: len(before)][frozen], before[frozen])


@pytest.mark.parametrize(("radius", "count"), [(1.5, 10**6), (100.0, 200), (100.0, 10**6), (0.01, 5)])
def test_prune_equals_its_twin(rng, radius, count):
    config = replace(CONFIG, radius=radius, max_voxels=count)
    fast, slow = random_pair(rng, config)
    before, centre = len(fast), np.array([0.5, -0.5, 0.25])
    fast.prune(centre)
    slow.prune(centre, radius, count)
    assert_same_cubes(fast, slow)
    assert len(fast) == before if radius == 100.0 and count > before else len(fast) < before
    queries = room_cloud(rng, 300).astype(np.float64)
    expected = [find_slowly(slow, q, 0.2, fallback=True) for q in queries]
    np.testing.assert_array_equal(fast.planes_at(queries, gate=0.2).source, [e[3] if e else 0 for e in expected])
    fast.insert(room_cloud(rng, 600), np.eye(4))  # a pruned map takes new points
    assert len(fast) > 0


@pytest.mark.parametrize("levels", [1, 3])
def test_what_was_not_seen_for_a_while_is_forgotten_as_by_its_twin(rng, levels):
    config = replace(CONFIG, levels=levels, max_points=60)
    corners = [room_cloud(rng, 900)[k::3] + np.float32([2.0 * k, 0.0, 0.0]) for k in (0, 1, 2, 0, 1, 0)]
    fast, slow = filled(config, corners, [np.eye(4)] * len(corners))
    sizes = []
    for insertions in (6, 3, 2, 1):
        fast.forget_unseen(insertions)
        slow.forget_unseen(insertions)
        assert_same_cubes(fast, slow)
        queries = np.concatenate(corners)[::9].astype(np.float64)
        expected = [find_slowly(slow, q, 0.2, fallback=True) for q in queries]
        np.testing.assert_array_equal(fast.planes_at(queries, gate=0.2).source, [e[3] if e else 0 for e in expected])
        sizes.append(len(fast))
    assert sizes[0] > sizes[1] > sizes[3] > 0
    for local_map in (fast, slow):  # and it goes on as any other
        local_map.insert(corners[2], np.eye(4))
    assert_same_cubes(fast, slow)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("levels", [1, 3])
def test_query_equals_brute_force(seed, levels):
    rng = np.random.default_rng(40 + seed)
    fast, slow = random_pair(rng, replace(CONFIG, levels=levels), points=700)
    queries = room_cloud(rng, 600, sigma=0.1).astype(np.float64) + rng.normal(scale=0.02, size=(600, 3))
    gate = 0.15
    got = fast.planes_at(queries, gate=gate)
    sources = set()
    for i, q in enumerate(queries):
        expected = find_slowly(slow, q, gate, fallback=True)
        assert got.source[i] == (expected[3] if expected else 0), f"query {i}"
        if expected is None:
            continue
        n, point, variance, source, tilt = expected
        sources.add(source)
        assert abs(got.normal[i] @ n) == pytest.approx(1.0, abs=2e-4)
        assert abs(got.normal[i] @ (q - got.point[i])) == pytest.approx(abs(n @ (q - point)), abs=2e-5)
        np.testing.assert_allclose(got.point[i], point, atol=2e-5)
        assert got.variance[i] == pytest.approx(variance, rel=3e-2)
        assert got.tilt[i] == pytest.approx(tilt, rel=5e-2, abs=1e-7)
    assert {1, 255} <= sources
    assert levels == 1 or 2 in sources


def test_query_far_from_the_origin_is_as_good(rng):
    cloud, away = room_cloud(rng, 3000), np.eye(4)
    away[:3, 3] = [40_000.0, -60_000.0, 500.0]  # a multiple of every cube's edge
    near, far = VoxelMap(CONFIG), VoxelMap(CONFIG)
    near.insert(cloud, np.eye(4))
    far.insert(cloud, away)
    queries = room_cloud(rng, 500).astype(np.float64)
    a, b = near.planes_at(queries, gate=0.1), far.planes_at(queries + away[:3, 3], gate=0.1)
    np.testing.assert_array_equal(a.source, b.source)
    assert (a.source > 0).mean() > 0.5
    np.testing.assert_allclose(a.normal[a.source > 0], b.normal[a.source > 0], atol=1e-3)


def test_edges_and_corners_make_no_plane(rng):
    """A cube that holds two walls is thick, one that holds a line is narrow: neither may answer."""
    config = replace(CONFIG, levels=1)
    crossing = np.concatenate([wall(rng, axis, 0.0, 300, half=0.16) for axis in ([1, 0, 0], [0, 1, 0])])
    line = np.zeros((300, 3), np.float32)
    line[:, 0] = rng.uniform(10.0, 10.5, 300)
    for cloud in (crossing + np.float32(0.25), line):
        local_map = VoxelMap(config)
        local_map.insert(cloud, np.eye(4))
        table = local_map.table()
        assert (table[table[:, 1] > 100][:, 11] < 0.0).all()


def test_nan_points_and_empty_clouds_change_nothing(rng):
    local_map = VoxelMap(CONFIG)
    local_map.insert(np.zeros((0, 3), np.float32), np.eye(4))
    local_map.insert(np.full((5, 3), np.nan, np.float32), np.eye(4))
    local_map.prune(np.zeros(3))
    assert len(local_map) == 0
    assert (local_map.planes_at(rng.normal(size=(4, 3)), gate=1.0).source == 0).all()
    assert local_map.planes_at(np.zeros((0, 3)), gate=1.0).normal.shape == (0, 3)


def test_memory_follows_the_volume_not_the_number_of_scans(rng):
    local_map = VoxelMap(CONFIG)
    cloud = room_cloud(rng, 6000)
    for _ in range(3):
        local_map.insert(cloud, np.eye(4))
    before = local_map.nbytes
    for _ in range(20):
        local_map.insert(cloud, np.eye(4))
    assert local_map.nbytes == before


def test_a_plane_knows_when_its_points_came(rng):
    local_map, floor = VoxelMap(), np.c_[rng.uniform(-2.0, 2.0, (4000, 2)), np.zeros(4000)].astype(np.float32)
    local_map.insert(floor, np.eye(4))
    local_map.insert(np.zeros((0, 3), np.float32), np.eye(4))
    local_map.insert(floor[floor[:, 0] > 0.0], np.eye(4))
    at = np.array([[-1.1, 0.6, 0.0], [1.1, 0.6, 0.0], [0.0, 0.0, 9.0]])
    np.testing.assert_allclose(local_map.planes_at(at, gate=0.1).since, [1.0, 2.0, -1.0], atol=1e-5)


def test_a_plane_knows_how_its_points_scatter_about_it(rng):
    floor = np.c_[rng.uniform(-2.0, 2.0, (40_000, 2)), 0.01 * rng.standard_normal(40_000) + 0.12].astype(np.float32)
    local_map = VoxelMap()
    local_map.insert(floor, np.eye(4))
    at = np.c_[rng.uniform(-1.9, 1.9, (200, 2)), np.full(200, 0.12)]
    found = local_map.planes_at(at, gate=0.1)
    np.testing.assert_allclose(np.sqrt(found.scatter.mean()), 0.01, rtol=0.05)
    assert local_map.planes_at(at + np.array([0.0, 0.0, 9.0]), gate=0.1).scatter.max() < 0.0


def test_a_map_that_forgets_a_little_at_a_time_is_the_one_that_forgets_at_once(rng):
    """Few cubes that go are taken out one by one, many by making the table anew; both lead to one map."""
    slowly, at_once, poses = VoxelMap(CONFIG), VoxelMap(CONFIG), [random_pose(rng) for _ in range(4)]
    for T in poses:
        cloud = (8.0 * room_cloud(rng, 3000)).astype(np.float32)
        slowly.insert(cloud, T)
        at_once.insert(cloud, T)
    full = len(at_once)
    for radius in np.linspace(20.0, 6.0, 60):
        slowly.native.prune(np.zeros(3), float(radius), 10**6)
    at_once.native.prune(np.zeros(3), 6.0, 10**6)
    assert 0 < len(at_once) < 0.7 * full

    def rows(local_map):
        return sorted(map(tuple, local_map.table().tolist()))

    assert rows(slowly) == rows(at_once)
    more = (4.0 * room_cloud(rng, 2000)).astype(np.float32)
    slowly.insert(more, poses[0])
    at_once.insert(more, poses[0])
    assert rows(slowly) == rows(at_once)
    queries = rng.uniform(-8.0, 8.0, (500, 3))
    a, b = (local_map.planes_at(queries, gate=0.5) for local_map in (slowly, at_once))
    assert (a.variance == b.variance).all() and (a.normal == b.normal).all() and np.isfinite(a.variance).any()
