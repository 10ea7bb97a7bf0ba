"""How far back the map may be matched: by way, by drift, and for what is still in view not at all."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.config import FilterConfig, MapConfig
from heliograph.maps import VoxelMap
from heliograph.odometry.filter.map_keeper import MapKeeper
from heliograph.odometry.filter.map_window import MapWindow
from states import random_state, room_cloud


def vouched(window, positions, walked=()):
    """What the window answers along a way, None where it does not move on."""
    walks = [*walked, *[0.0] * (len(positions) - len(walked))]
    return [window.moved(np.array([x, 0.0, 0.0]), w) for x, w in zip(positions, walks, strict=True)]


@pytest.mark.parametrize("step", [0.03, 0.4, 7.0])
def test_window_ends_its_length_of_way_ago(step):
    window = MapWindow(MapConfig(window=60.0))
    answers = [(k, n) for k, n in enumerate(vouched(window, step * np.arange(int(200.0 / step)))) if n is not None]
    assert answers[0][0] * step == pytest.approx(60.0, abs=max(2.0, 2.0 * step))
    for _, scans in answers:
        assert 60.0 - 2.0 * max(step, 0.5) <= scans * step <= 60.0 + 10.0 + 2.0 * step
    assert np.diff([k for k, _ in answers]).min() * step > 9.0 - step  # and is looked at six times a length


def test_way_counts_forth_and_back_but_not_a_trembling_at_rest():
    window = MapWindow(MapConfig(window=60.0))
    there_and_back = np.concatenate([np.arange(0.0, 40.0), np.arange(40.0, 0.0, -1.0)])
    assert any(n is not None for n in vouched(window, there_and_back))
    window.begin()
    rng = np.random.default_rng(0)
    assert all(n is None for n in vouched(window, 0.02 * rng.normal(size=20_000)))


def test_drift_shortens_the_window():
    window = MapWindow(MapConfig(window=60.0, window_drift=0.1))
    still = [0.0] * 3 + [0.09**2] * 2 + [0.11**2] * 3
    assert vouched(window, [0.0] * len(still), still) == [None] * 5 + [3, None, None]


def test_no_length_means_no_window():
    assert all(n is None for n in vouched(MapWindow(MapConfig(window=0.0)), np.arange(0.0, 500.0)))


@pytest.mark.parametrize("window", [60.0, 0.0])
def test_keeper_forgets_the_start_of_a_long_way_and_keeps_the_room_in_view(rng, window):
    """A room behind goes once the way is long enough; one that every scan still sees stays, however long the way."""
    room, state = room_cloud(rng, 3000), random_state(rng)
    config = MapConfig(window=window, radius=1000.0)
    keeper = MapKeeper(VoxelMap(config), FilterConfig(systematic=0.0), config, np.zeros(3))
    seen = SimpleNamespace(share=np.ones(6), covariance=lambda: np.eye(6), matches=3.0)
    for k in range(100):
        at = np.eye(4)
        at[0, 3] = 100.0 if 0 < k < 99 else 0.0
        state = replace(state, p_odom=np.array([float(k), 0.0, 0.0]))
        keeper.extend(room, at, state, seen)
        if k == 97:
            behind, ahead = (
                (keeper.map.planes_at(room[::20] + np.array([x, 0.0, 0.0]), gate=0.1).source > 0).mean()
                for x in (0.0, 100.0)
            )
            assert ahead > 0.8
            assert behind > 0.8 if window == 0.0 else behind == 0.0
