"""What scans after one another err alike, and how fast the map's frame follows it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.config import FilterConfig, MapConfig
from heliograph.maps import PlaneMatches, VoxelMap
from heliograph.odometry.filter.drift import MapDrift
from heliograph.odometry.filter.lasting import Drag, LastingErrors, MatchedPoints
from heliograph.odometry.filter.map_keeper import MapKeeper
from heliograph.registration import MatchSettings, linearize, true_share
from states import random_rotation, random_state

SETTINGS = MatchSettings(gate=0.2, kernel=0.1, sigma=0.02)
SEEN = SimpleNamespace(
    share=np.ones(6),
    matches=300.0,
    covariance=lambda: np.eye(6),
    spread=lambda _: np.diag([0.0, 0.0, 0.0, 2e-6, 0.5e-6, 0.5e-6]),
)
CLOUD = np.random.default_rng(5).uniform(-9.0, 9.0, (600, 3)).astype(np.float32)
POINTS = MatchedPoints(points_imu=CLOUD, settings=SETTINGS)


class ThreeWalls(VoxelMap):
    """Planes that face the axes in turn, and when the points of each came."""

    def __init__(self, *since):
        super().__init__()
        self.since = since

    def planes_at(self, points_odom, *, gate, neighbours=True):
        count = len(points_odom)
        which = np.arange(count) % 3
        return PlaneMatches(
            normal=np.eye(3, dtype=np.float32)[which],
            point=points_odom,
            variance=np.zeros(count, np.float32),
            source=np.ones(count, np.uint8),
            scatter=np.full(count, 1e-4, np.float32),
            since=None if not self.since else np.array(self.since, np.float32)[which],
        )


def walked(lasting, local_map, state, metres, seen=SEEN):
    """The drags of scans half a metre apart along x."""
    at = [replace(state, p_odom=state.p_odom + np.array([0.5 * (k + 1), 0.0, 0.0])) for k in range(int(2 * metres))]
    return [lasting.dragged(local_map, one, seen, POINTS) for one in at]


@pytest.fixture
def level(rng):
    return replace(random_state(rng), R_odom_imu=np.eye(3), p_odom=np.zeros(3))


def test_frame_follows_an_axis_as_fast_as_the_planes_that_face_it_are_replaced(level):
    """Planes facing x came 2 m ago, those facing y 8 m, those facing z have no age: they are as young as can be."""
    lasting = LastingErrors(15.0)
    lasting.dragged(ThreeWalls(1, 1, 1), level, None, None)
    walked(lasting, ThreeWalls(1, 1, 1), level, 10.0)
    last = lasting.dragged(ThreeWalls(18, 6, 21), replace(level, p_odom=np.array([10.5, 0.0, 0.0])), SEEN, POINTS)
    expected = [0.5 / 2.0 * 2e-3, 0.5 / 8.0 * 1e-3, 1e-3]
    np.testing.assert_allclose(np.diag(last.gain), expected, rtol=0.1)
    assert last.kept == pytest.approx(np.exp(-0.5 / 15.0))


def test_way_back_is_not_credited_with_what_it_undoes(level):
    turned = replace(level, R_odom_imu=np.diag([-1.0, -1.0, 1.0]))
    gains = []
    for state in (level, turned):
        lasting = LastingErrors(15.0)
        lasting.dragged(ThreeWalls(1, 1, 1), state, None, None)
        gains.append(walked(lasting, ThreeWalls(1, 1, 1), state, 1.0)[-1].gain)
    np.testing.assert_allclose(gains[0], gains[1], rtol=1e-6, atol=1e-9)


def test_nothing_is_dragged_at_rest_nor_where_nothing_tells_an_age(level):
    lasting = LastingErrors(15.0)
    assert all(lasting.dragged(ThreeWalls(1, 1, 1), level, SEEN, POINTS) is None for _ in range(50))
    for local_map, seen in ((ThreeWalls(), SEEN), (ThreeWalls(-1, -1, -1), SEEN), (ThreeWalls(1, 1, 1), None)):
        assert not any(walked(LastingErrors(15.0), local_map, level, 2.0, seen))
    assert not any(walked(LastingErrors(15.0), object(), level, 2.0))


def test_scans_at_rest_do_not_make_a_plane_old(level):
    """Fifty scans at one place, then a metre: what came before is a metre old, whatever its number."""
    lasting = LastingErrors(15.0)
    for _ in range(50):
        lasting.dragged(ThreeWalls(1, 1, 1), level, SEEN, POINTS)
    first = walked(lasting, ThreeWalls(3, 25, 50), level, 1.0)[-1]
    np.testing.assert_allclose(np.diag(first.gain), [0.5 * 2e-3, 0.5 * 1e-3, 0.5 * 1e-3], rtol=1e-5)


@pytest.mark.parametrize(("kept", "times"), [(1.0, 40.0), (0.0, np.sqrt(40.0))])
def test_what_lasts_adds_up_along_the_way_and_what_does_not_as_a_walk(kept, times, rng):
    state, gain = random_state(rng), 1e-3 * random_rotation(rng)
    state, drift = replace(state, covariance=np.zeros((17, 17))), MapDrift(0.0)
    for _ in range(40):
        drift.drag(Drag(gain=gain, kept=kept))
    position = drift.pose_covariance(state)[3:, 3:]
    np.testing.assert_allclose(position, (times * 1e-3) ** 2 * np.eye(3), rtol=1e-9, atol=1e-15)
    assert drift.walked == pytest.approx(np.trace(position))


def test_opposite_slides_cancel(rng):
    state, drift = replace(random_state(rng), covariance=np.zeros((17, 17))), MapDrift(0.0)
    for sign in (1.0, -1.0):
        for _ in range(20):
            drift.drag(Drag(gain=sign * 1e-3 * np.eye(3), kept=1.0))
    assert np.abs(drift.pose_covariance(state)).max() < 1e-15


def corridor(rng, x, doors=True):
    """Points on a floor and two walls around x, and on what faces x if there are doors."""
    n = 3000
    along, side = rng.uniform(x - 6.0, x + 6.0, n), rng.choice([-1.0, 1.0], n)
    points = [np.c_[along, 1.2 * side, rng.uniform(-1.0, 1.0, n)], np.c_[along, rng.uniform(-1.2, 1.2, n), -np.ones(n)]]
    if doors:
        for at in np.arange(np.ceil((x - 6.0) / 2.0) * 2.0, x + 6.0, 2.0):
            points.append(np.c_[np.full(60, at + 0.13), rng.uniform(0.7, 1.1, 60), rng.uniform(-1.0, 1.0, 60)])
    points = np.concatenate(points)
    return (points + 0.005 * rng.standard_normal(points.shape) - [x, 0.0, 0.0]).astype(np.float32)


def test_keeper_slides_along_a_corridor_and_not_off_its_floor(rng, level):
    state = replace(level, covariance=np.zeros((17, 17)))
    keeper = MapKeeper(VoxelMap(), FilterConfig(systematic=0.0), MapConfig(), np.zeros(3))
    for k in range(40):
        cloud, T = corridor(rng, 0.25 * k), np.eye(4)
        T[0, 3] = 0.25 * k
        here = replace(state, p_odom=T[:3, 3])
        picked = np.ascontiguousarray(cloud[::2])
        seen = true_share(linearize(keeper.map, picked, T, SETTINGS)) if k else None
        keeper.extend(cloud, T, here, seen, replace(POINTS, points_imu=picked) if k else None)
    sigma = np.sqrt(np.diag(keeper.pose_covariance(here))[3:])
    assert 1e-4 < sigma[0] < 20e-3
    assert sigma[2] < 0.6 * sigma[0], sigma
