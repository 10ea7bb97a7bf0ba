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
