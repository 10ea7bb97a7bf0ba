"""Thinning and gating against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.cloud import range_gate, voxel_downsample
from reference.clouds import downsample_slowly, range_gate_slowly


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), leaf=st.floats(0.05, 3.0), spread=st.floats(0.1, 200.0))
def test_downsample_equals_its_twin(seed, leaf, spread):
    rng = np.random.default_rng(seed)
    points = (spread * rng.normal(size=(200, 3))).astype(np.float32)
    points[rng.integers(0, 200, 5), rng.integers(0, 3, 5)] = [np.nan, np.inf, -np.inf, np.nan, 0.0]
    np.testing.assert_array_equal(voxel_downsample(points, leaf), downsample_slowly(points, leaf))


def test_downsample_keeps_one_of_each_cube_on_both_sides_of_zero():
    points = np.array([[0.1, 0, 0], [0.4, 0, 0], [-0.1, 0, 0], [-0.4, 0, 0], [0.6, 0, 0]], np.float32)
    kept = voxel_downsample(points, 0.5)
    np.testing.assert_array_equal(np.floor(points[kept, 0] / 0.5), [-1, 0, 1])


def test_downsample_does_not_depend_on_the_order_of_the_points(rng):
    points = rng.normal(scale=5.0, size=(3000, 3)).astype(np.float32)
    shuffled = points[rng.permutation(len(points))]
    np.testing.assert_array_equal(shuffled[voxel_downsample(shuffled, 1.0)], points[voxel_downsample(points, 1.0)])


def test_downsample_favours_no_side_of_a_wall(rng):
    walls = rng.uniform(-20.0, 20.0, (40_000, 3))
    walls[:, 0] = 5.3 + 0.02 * rng.normal(size=len(walls))
    walls = walls.astype(np.float32)
    kept = walls[voxel_downsample(walls, 0.5), 0]
    assert len(kept) > 5000
    assert abs(kept.mean() - 5.3) < 4.0 * 0.02 / np.sqrt(len(kept))


def test_downsample_grows_past_its_first_table(rng):
    points = rng.uniform(-500.0, 500.0, (60_000, 3)).astype(np.float32)
    kept = voxel_downsample(points, 0.1)
    assert len(kept) > 59_000
    assert len(np.unique(kept)) == len(kept)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), low=st.floats(0.0, 5.0), span=st.floats(0.0, 50.0))
def test_range_gate_equals_its_twin(seed, low, span):
    rng = np.random.default_rng(seed)
    points = (10.0 * rng.normal(size=(200, 3))).astype(np.float32)
    points[:3, 1] = [np.nan, np.inf, -np.inf]
    np.testing.assert_array_equal(range_gate(points, low, low + span), range_gate_slowly(points, low, low + span))


@pytest.mark.parametrize("function", [lambda p: voxel_downsample(p, 0.5), lambda p: range_gate(p, 0.0, 1.0)])
def test_thinning_of_nothing_is_nothing(function):
    kept = function(np.zeros((0, 3), np.float32))
    assert kept.shape == (0,)
    assert kept.dtype == np.int32
