"""The averaged map against its twin."""

import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.maps import GlobalMap
from reference.maps import SlowGlobalMap
from states import random_pose


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("intensity", [True, False])
def test_global_map_equals_its_twin(seed, intensity):
    rng = np.random.default_rng(seed)
    fast, slow = GlobalMap(0.3), SlowGlobalMap(0.3)
    for _ in range(3):
        cloud = rng.normal(size=(701, 3)).astype(np.float32)
        cloud[rng.integers(0, 701, 4), rng.integers(0, 3, 4)] = [np.nan, np.inf, -np.inf, np.nan]
        values = rng.uniform(0.0, 255.0, 701).astype(np.float32) if intensity else None
        T = random_pose(rng, 3.0)
        fast.insert(cloud, values, T)
        slow.insert(cloud, values, T)
    means = slow.means()
    np.testing.assert_allclose(fast.points(), means[:, :3], atol=1e-5)
    np.testing.assert_allclose(fast.intensity(), means[:, 3], rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(fast.counts(), slow.counts())
    assert len(fast) == len(means)


def test_empty_map_gives_empty_arrays():
    empty = GlobalMap(0.1)
    empty.insert(np.zeros((0, 3), np.float32), None, np.eye(4))
    assert empty.points().shape == (0, 3)
    assert empty.counts().shape == empty.intensity().shape == (0,)


def test_memory_grows_with_the_volume_only(rng):
    cloud, grown = rng.uniform(-5, 5, (3000, 3)).astype(np.float32), GlobalMap(0.2)
    grown.insert(cloud, None, np.eye(4))
    before = grown.nbytes
    for _ in range(10):
        grown.insert(cloud, None, np.eye(4))
    assert grown.nbytes == before
    assert grown.counts().max() >= 11


def test_large_map_survives_the_growth_of_its_table(rng):
    cloud, grown = rng.uniform(-400, 400, (150_000, 3)).astype(np.float32), GlobalMap(0.05)
    grown.insert(cloud, None, np.eye(4))
    np.testing.assert_allclose(grown.points(), cloud, atol=1e-4)


def test_global_map_refuses_a_voxel_of_nothing():
    with pytest.raises(DataError, match=r"voxel is 0\.0, expected an edge above 0 m"):
        GlobalMap(0.0)


@pytest.mark.parametrize("kilometres", [60.0, 200.0])
def test_global_map_far_from_the_origin_is_the_same_map(rng, kilometres):
    """Keys count from the map's first cube; a point at 52 501 m once came back at -52 357 m."""
    cloud = rng.uniform(-30.0, 30.0, (3000, 3)).astype(np.float32)
    near, far, T = GlobalMap(0.1), GlobalMap(0.1), np.eye(4)
    T[:3, 3] = 1e3 * kilometres, -1e3 * kilometres, 0.0
    near.insert(cloud, None, np.eye(4))
    far.insert(cloud, None, T)
    assert len(far) == len(near)
    np.testing.assert_allclose(far.means(), near.means() + T[:3, 3], atol=1e-6)
    surfaces = near.averaged(0.02).points
    np.testing.assert_allclose(far.averaged(0.02).points, surfaces + T[:3, 3], atol=1e-5)


def test_global_map_refuses_what_its_keys_cannot_tell_apart():
    whole, T = GlobalMap(0.1), np.eye(4)
    whole.insert(np.zeros((1, 3), np.float32), None, T)
    T[0, 3] = 60_000.0
    with pytest.raises(DataError, match="put it together in tiles"):
        whole.insert(np.zeros((1, 3), np.float32), None, T)


def test_global_map_does_not_drift_while_standing():
    """Sums of floats round what is added to them one way, the longer the more: by 40 % of a voxel after an hour."""
    cloud = np.full((200_000, 3), 0.07, np.float32)
    whole = GlobalMap(0.1)
    for _ in range(60):
        whole.insert(cloud, np.full(len(cloud), 7.3, np.float32), np.eye(4))
    np.testing.assert_allclose(whole.means(), [[0.07] * 3], atol=2e-5)
    np.testing.assert_allclose(whole.intensity(), [7.3], rtol=1e-3)


def test_global_map_counts_visits_and_forgets_cubes(rng):
    part, whole = GlobalMap(0.2), GlobalMap(0.2)
    part.insert(rng.uniform(-2.0, 2.0, (500, 3)).astype(np.float32), None, np.eye(4))
    for number in (5, 9):
        whole.merge(part.cells(), visit=number)
    assert set(whole.visits().tolist()) == {2} and set(whole.averaged(0.0).first.tolist()) == {5}
    wanted = np.arange(len(whole)) % 2 == 0
    means = whole.means()
    whole.keep(wanted)
    np.testing.assert_array_equal(whole.means(), means[wanted])
    whole.merge(part.cells())
    assert len(whole) == len(part)


def test_global_map_normals_are_those_of_planes(rng):
    p = rng.uniform(-2.0, 2.0, (4000, 3))
    p[:3000, 2] = rng.normal(0.0, 0.01, 3000)
    p[3000:, :2] = 5.0 + rng.normal(0.0, 0.01, (1000, 2))
    whole = GlobalMap(0.2)
    whole.insert(p.astype(np.float32), None, np.eye(4))
    normals, means = whole.normals(np.arange(len(whole), dtype=np.uint32)), whole.means()
    floor = (np.abs(means[:, :2]) < 1.5).all(axis=1)
    assert np.median(np.abs(normals[floor, 2])) > 0.98
    pole = means[:, 0] > 4.0
    assert not normals[pole].any()
