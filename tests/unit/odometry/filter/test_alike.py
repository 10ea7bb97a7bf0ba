"""How many matches of a scan tell as much as one, by the residuals of the scan itself."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.maps import PlaneMatches, VoxelMap
from heliograph.odometry.filter.alike import AlikeErrors, design_effect
from heliograph.odometry.filter.calibrating import CalibrationTerms
from heliograph.odometry.filter.matching import ScanMatcher
from heliograph.registration import MatchSettings
from scenes import corner_room
from states import random_state

SETTINGS = MatchSettings(gate=0.2, kernel=0.1, sigma=0.02)
EDGE = 15.0


class OffWalls(VoxelMap):
    """Planes that face the axes in turn, off from their points by an error of each point and one of each cube."""

    def __init__(self, own, shared, seed=3):
        super().__init__()
        self.own, self.shared, self.seed = own, shared, seed

    def planes_at(self, points_odom, *, gate, neighbours=True):
        rng, count = np.random.default_rng(self.seed), len(points_odom)
        n = np.eye(3, dtype=np.float32)[rng.integers(0, 3, count)]
        _, cube = np.unique(np.floor(points_odom / EDGE), axis=0, return_inverse=True)
        off = rng.normal(0.0, self.own, count) + rng.normal(0.0, 1.0, cube.max() + 1)[cube.ravel()] * self.shared
        return PlaneMatches(
            normal=n,
            point=points_odom - off[:, None] * n,
            variance=np.zeros(count, np.float32),
            source=np.ones(count, np.uint8),
        )


@pytest.fixture
def level(rng):
    return replace(random_state(rng), R_odom_imu=np.eye(3), p_odom=np.zeros(3))


@pytest.fixture
def cloud(rng):
    return rng.uniform(-60.0, 60.0, (900, 3)).astype(np.float32) * np.float32([1.0, 1.0, 0.2])


def mean_effect(own, shared, level, cloud):
    effects = [design_effect(OffWalls(own, shared, seed), cloud, level, SETTINGS, EDGE) for seed in range(20)]
    return float(np.exp(np.mean(np.log(effects))))


def test_independent_errors_count_once(level, cloud):
    assert mean_effect(0.01, 0.0, level, cloud) == pytest.approx(1.0, abs=0.15)


def test_errors_shared_in_a_cube_count_as_often_as_they_are_shared(level, cloud):
    """Half of the variance shared by m matches in a cube: of one axis a third of them, so 1 + m / 6 times."""
    _, members = np.unique(np.floor(cloud / EDGE), axis=0, return_counts=True)
    often = float(np.sum(members**2) / np.sum(members))
    assert mean_effect(0.007, 0.007, level, cloud) == pytest.approx(1.0 + (often - 1.0) / 6.0, rel=0.25)


def test_few_points_asked_stand_for_all(level, cloud, rng):
    """Five times the points in place of one: as many errors are shared, and the estimate from a part is that of all."""
    many = np.repeat(cloud, 5, axis=0) + rng.normal(0.0, 0.1, (4500, 3)).astype(np.float32)
    whole = 1.0 + 5.0 * (mean_effect(0.007, 0.007, level, cloud) - 1.0)
    assert mean_effect(0.007, 0.007, level, many) == pytest.approx(whole, rel=0.3)


def test_running_mean_rises_with_errors_that_are_shared_and_is_never_below_one(level, cloud):
    alike = AlikeErrors(EDGE)
    for _ in range(4):
        alike.learn(OffWalls(0.01, 0.0), cloud, level, SETTINGS)
    assert alike.factor == 1.0  # looked at one in five only
    for seed in range(200):
        alike.learn(OffWalls(0.0, 0.01, seed), cloud, level, SETTINGS)
    shared = alike.factor
    assert shared > 2.0
    other = AlikeErrors(EDGE)
    other.restore(alike.snapshot())
    assert other.factor == shared
    for seed in range(600):
        alike.learn(OffWalls(0.01, 0.0, seed), cloud, level, SETTINGS)
    assert 1.0 <= alike.factor < 1.2


def test_too_few_matches_tell_nothing(level, cloud):
    assert design_effect(OffWalls(0.01, 0.01), cloud[:50], level, SETTINGS, EDGE) is None
    assert design_effect(OffWalls(0.0, 0.0), cloud, level, SETTINGS, EDGE) is None


def test_a_scan_weighs_less_by_what_the_scans_before_have_shown(level, rng):
    planes, points = VoxelMap(), corner_room(rng, density=100)
    planes.insert(corner_room(rng, density=300), np.eye(4))
    matcher, sure = ScanMatcher(RunConfig(), threads=1), replace(level, covariance=1e-6 * level.covariance)

    def information():
        before_end = np.zeros(len(points), np.float32)
        fit = matcher.registered(sure, planes, lambda _: points, before_end, CalibrationTerms())
        return np.trace(fit.measurement.information)

    before = information()
    snapshot = matcher.snapshot()
    matcher.restore({**snapshot, "_alike": {**snapshot["_alike"], "_log": float(np.log(9.0))}})
    assert information() == pytest.approx(before / 9.0, rel=0.05)
