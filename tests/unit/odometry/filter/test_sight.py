"""What scans see together: chance averages out on the way, not at rest, and a change of the place is not averaged."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import MapConfig
from heliograph.maps import VoxelMap
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.sight import SeenInformation, SightOfScans
from heliograph.registration import MatchSettings, linearize, split_information, true_share
from heliograph.testing import assert_goes_on
from states import random_state

AXIS = np.eye(3)[0]
SETTINGS = MatchSettings(gate=0.15, kernel=0.06, sigma=0.02, fallback_stride=0)


def tube(rng, count, *, ends=False):
    """Points on the walls of a tube along x, 30 m long, and on one end if there is any; noise across them."""
    along, across = rng.uniform(-15.0, 15.0, count), rng.uniform(-2.1, 2.1, count)
    side, noise = rng.integers(0, 4, count), 0.02 * rng.standard_normal(count)
    wall = 2.1 * (2 * (side % 2) - 1) + noise
    points = np.stack([along, np.where(side < 2, wall, across), np.where(side < 2, across, wall)], axis=1)
    if ends:
        some = rng.random(count) < 0.02
        points[some] = np.stack([15.0 + noise[some], *rng.uniform(-2.1, 2.1, (2, some.sum()))], axis=1)
    return points.astype(np.float32)


def at(x):
    return replace(random_state(np.random.default_rng(0)), R_odom_imu=np.eye(3), p_odom=x * AXIS)


def scans(count, seed=0, *, motion=True, **kinds):
    """Sums of several scans of a tube, each against a map of its own, so that their chance is independent."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        local_map = VoxelMap(MapConfig())
        for _ in range(2):
            local_map.insert(tube(rng, 6000, **kinds), np.eye(4))
        points = tube(rng, 1500, **kinds)
        before_end = rng.uniform(0.0, 0.1, len(points)).astype(np.float32) if motion else None
        found.append(linearize(local_map, points, np.eye(4), SETTINGS, before_end=before_end))
    return found


@pytest.mark.parametrize("step", [0.5, 0.0])
def test_chance_averages_out_on_the_way_and_not_at_rest(step):
    sight, sums = SightOfScans(), scans(5)
    for k, one in enumerate(sums):
        together = sight.with_scan(one, at(k * step))
        sight.take(together)
    alone = SightOfScans().with_scan(sums[-1], at(0.0)).scatter
    assert together.count == 5
    assert together.scatter == pytest.approx(alone / np.sqrt(5) if step else alone, rel=0.15)
    assert together.pose().share[0] == 0.0  # a tube is a tube however often one looks
    assert abs(together.pose().blind()[3, 3]) > 0.9


def test_one_scan_has_the_share_it_had_alone(rng):
    (sums,) = scans(1)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    state = replace(at(0.0), R_odom_imu=R * np.sign(np.linalg.det(R)))
    sight = SightOfScans().with_scan(sums, state)
    for columns in (slice(None), sums.columns_of("pose")):
        found, alone = sight.seen(sums, state, columns), true_share(sums, columns)
        np.testing.assert_allclose(found.feigned, alone.feigned, atol=1e-9)
        np.testing.assert_allclose(found.information(), alone.information(), atol=1e-6 * np.abs(alone.duals).max() ** 2)
        np.testing.assert_allclose(found.of(sums.information[columns, columns]), found.information(), atol=1e-3)


def test_ends_that_come_into_view_are_seen_at_once_and_missed_at_once():
    (blind,), (open_,) = scans(1), scans(1, ends=True)
    for first, second in ((blind, open_), (open_, blind)):
        sight = SightOfScans()
        for k in range(5):
            sight.take(sight.with_scan(first, at(0.5 * k)))
        together = sight.with_scan(second, at(2.5))
        assert together.count == 1
        assert bool(together.pose().share.all()) is (second is open_)


def test_a_scan_that_is_sure_needs_no_others():
    (sums,) = scans(1, ends=True)
    sight = SightOfScans()
    sight.take(SeenInformation.of(scans(1)[0], at(0.0)))
    sure = split_information(sums.information, 1e-3 * sums.feigned, 0.1, 1.0)
    assert sight.plain(sure)
    assert not sight.plain(true_share(scans(1)[0]))


def test_what_is_blind_of_the_pose_tells_nothing_of_a_motion_that_is_not_known():
    (sums,) = scans(1)
    told = ScanMeasurement.of(sums).only_true(SightOfScans(), at(0.0), motion_known=False)
    unseen = told.pose_share().blind()[:, 3]  # the error along the axis, with the turn that goes with it
    unmoved = np.concatenate([-unseen[3:], unseen[:3]])  # the motion's columns begin with the velocity's
    for columns, u in ((slice(0, 6), unseen), (slice(6, 12), unmoved)):
        assert u @ sums.information[columns, columns] @ u > 1.0
        assert abs(u @ told.information[columns, columns] @ u) < 1e-6
        np.testing.assert_allclose(u @ told.gradient[columns], 0.0, atol=1e-6)


def test_it_goes_on_from_its_state():
    sums = scans(3)

    def step(sight, k):
        together = sight.with_scan(sums[k], at(0.3 * k))
        sight.take(together)
        return together.scatter

    assert_goes_on(SightOfScans, step, range(3), at=2)
