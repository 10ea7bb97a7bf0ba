"""The local map in the filter's hands: counted, pruned, begun anew with what that costs in certainty."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.config import FilterConfig, MapConfig
from heliograph.odometry.filter.map_keeper import MapKeeper
from neighbour_map import NeighbourMap
from states import random_state, room_cloud


class Watched(NeighbourMap):
    def __init__(self):
        super().__init__(spacing=0.2)
        self.pruned = []

    def prune(self, centre_odom):
        self.pruned.append(centre_odom)
        super().prune(centre_odom)


@pytest.fixture
def keeper():
    return MapKeeper(Watched(), FilterConfig(systematic=0.0), MapConfig(), np.zeros(3))


def extended(keeper, state, cloud, *, matched=True):
    seen = SimpleNamespace(share=np.ones(6), covariance=lambda: np.eye(6), matches=3.0)
    keeper.extend(cloud, np.eye(4), state, seen if matched else None)


def test_map_begun_anew_is_as_uncertain_as_the_pose_that_ties_it(keeper, rng):
    state, cloud = random_state(rng), room_cloud(rng, 1200)
    certain = replace(state, covariance=np.zeros((17, 17)))
    extended(keeper, certain, cloud, matched=False)
    extended(keeper, certain, cloud)
    assert not keeper.pose_covariance(certain).any()
    keeper.begin_anew(state)
    assert keeper.empty
    np.testing.assert_allclose(keeper.pose_covariance(certain), state.covariance[:6, :6], rtol=1e-9)


def test_scans_count_from_the_first_that_left_something(keeper, rng):
    state, cloud = random_state(rng), room_cloud(rng, 1200)
    assert (keeper.empty, keeper.scans) == (True, 0)
    for points in (cloud[:0], cloud[:0], cloud):
        extended(keeper, state, points, matched=False)
        assert keeper.scans == 1
    extended(keeper, state, cloud)
    assert (keeper.empty, keeper.scans) == (False, 2)
    keeper.begin_anew(state)
    extended(keeper, state, cloud)
    assert keeper.scans == 1


def test_map_is_pruned_once_in_ten_metres(keeper, rng):
    state, cloud = random_state(rng), room_cloud(rng, 1200)
    for x in (0.0, 9.0, 11.0, 20.0, 22.0):
        extended(keeper, replace(state, p_odom=np.array([x, 0.0, 0.0])), cloud)
    assert [centre[0] for centre in keeper.map.pruned] == [11.0, 22.0]
