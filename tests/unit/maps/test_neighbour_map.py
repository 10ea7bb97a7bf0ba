"""A user's own map obeys the same law, and the law catches maps that do not."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.maps import LocalMap, VoxelMap
from heliograph.testing import assert_local_map
from neighbour_map import NeighbourMap


def test_example_map_obeys_the_law(rng):
    assert isinstance(NeighbourMap(), LocalMap)
    assert_local_map(NeighbourMap, rng)


class IgnoresThePose(NeighbourMap):
    def insert(self, points_body, T_odom_body):
        return super().insert(points_body, np.eye(4))


class IgnoresTheGate(NeighbourMap):
    def planes_at(self, points_odom, *, gate):
        return super().planes_at(points_odom, gate=1e9)


class ForgetsNothing(NeighbourMap):
    def prune(self, centre_odom):
        pass


class ForgetsAll(NeighbourMap):
    def prune(self, centre_odom):
        self.points, self._tree = self.points[:0], None


class LongNormals(NeighbourMap):
    def planes_at(self, points_odom, *, gate):
        found = super().planes_at(points_odom, gate=gate)
        return replace(found, normal=1.1 * found.normal)


class ChokesOnNan(NeighbourMap):
    def insert(self, points_body, T_odom_body):
        return super().insert(np.nan_to_num(points_body), T_odom_body)


class NothingIsNew(NeighbourMap):
    def insert(self, points_body, T_odom_body):
        return 0.0 * super().insert(points_body, T_odom_body)


class SidewaysPoints(NeighbourMap):
    def planes_at(self, points_odom, *, gate):
        found = super().planes_at(points_odom, gate=gate)
        return replace(found, point=found.point + 0.05)


@pytest.mark.parametrize(
    "broken",
    [
        IgnoresThePose,
        IgnoresTheGate,
        ForgetsNothing,
        ForgetsAll,
        LongNormals,
        ChokesOnNan,
        SidewaysPoints,
        NothingIsNew,
    ],
)
def test_law_catches_a_broken_map(rng, broken):
    with pytest.raises(AssertionError):
        assert_local_map(broken, rng)


def test_law_holds_for_many_draws():
    for seed in range(5):
        assert_local_map(VoxelMap, np.random.default_rng(seed))
