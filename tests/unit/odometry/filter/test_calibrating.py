"""The filter's mounting and clock: where a scan belongs on a map made with another mounting, and short whole runs.

The runs are the fast siblings of tests/system/test_calibrating_odometry.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data.error_layout import CALIBRATION, CLOCK, FULL_DIM, MOUNTED_DIM, MOUNTING, NAV_DIM
from heliograph.lie import se3, so3
from heliograph.odometry.filter.calibrating import (
    FixedCalibration,
    FreeMounting,
    GatedCalibration,
    calibration_of,
    with_calibration,
)
from heliograph.odometry.filter.motion import MotionModel
from neighbour_map import NeighbourMap
from online_trials import CONFIG, online_trial
from states import NOISE, START_NS, random_imu, random_pose, random_state, rest_state, resting

FILTER = RunConfig().filter
SMALL = replace(CONFIG, cloud=replace(CONFIG.cloud, target_points=1000))


def state_at(T_odom_imu, T_imu_lidar, dim=MOUNTED_DIM):
    state = random_state(np.random.default_rng(0), dim=dim)
    return replace(state, R_odom_imu=T_odom_imu[:3, :3], p_odom=T_odom_imu[:3, 3], T_imu_lidar=T_imu_lidar)


@pytest.mark.parametrize("dim", [MOUNTED_DIM, FULL_DIM])
@pytest.mark.parametrize("seed", range(3))
def test_map_pose_puts_a_point_of_the_world_where_the_map_has_it(seed, dim):
    """Seen first with the wrong mounting of the map, and again when the true one is known: one place on the map."""
    rng = np.random.default_rng(seed)
    T_first, T_later, true = (random_pose(rng, reach) for reach in (5.0, 5.0, 0.5))
    wrong = true @ se3.exp(rng.normal(scale=0.1, size=6))
    calibration = calibration_of(state_at(T_first, wrong, dim), FILTER)
    world = np.append(rng.uniform(-20.0, 20.0, 3), 1.0)

    def inserted(T_odom_imu, pose):
        seen = np.linalg.inv(T_odom_imu @ true) @ world
        return pose @ calibration.T_imu_lidar @ seen

    first = state_at(T_first, calibration.T_imu_lidar, dim)
    on_map = inserted(T_first, calibration.map_pose(first, first=True))
    np.testing.assert_allclose(on_map, T_first @ wrong @ np.linalg.inv(T_first @ true) @ world, atol=1e-9)
    again = inserted(T_later, calibration.map_pose(state_at(T_later, true, dim), first=False))
    np.testing.assert_allclose(again, on_map, atol=1e-9)
    assert np.linalg.norm(on_map - world) > 0.1


def test_map_pose_of_a_mounting_as_given_is_the_pose(rng):
    T, mounting = random_pose(rng), random_pose(rng, 0.3)
    fixed = calibration_of(state_at(T, mounting, NAV_DIM), FILTER)
    np.testing.assert_array_equal(fixed.map_pose(state_at(T, mounting, NAV_DIM), first=False), T)


def test_calibration_is_what_the_start_s_covariance_holds(rng):
    kinds = {NAV_DIM: FixedCalibration, MOUNTED_DIM: FreeMounting, FULL_DIM: GatedCalibration}
    for dim, kind in kinds.items():
        assert type(calibration_of(random_state(rng, dim=dim), FILTER)) is kind
    known = random_state(rng, dim=MOUNTED_DIM)
    covariance = known.covariance.copy()
    covariance[MOUNTING] = covariance[:, MOUNTING] = 0.0
    assert type(calibration_of(replace(known, covariance=covariance), FILTER)) is FixedCalibration


def test_gate_grows_by_what_one_prediction_did_to_the_state(rng):
    """A prediction of the state is all that the gate needs: its own covariance goes the same way."""
    state, imu, end_ns = random_state(rng, dim=FULL_DIM), random_imu(rng), START_NS + 100_000_000
    motion, other = MotionModel(RunConfig().imu, FILTER, NOISE), random_state(rng, dim=FULL_DIM).covariance
    ahead = motion.predict(state, imu, end_ns)
    np.testing.assert_array_equal(ahead.growth.grown(state.covariance), ahead.state.covariance)
    alone = motion.predict(replace(state, covariance=other), imu, end_ns).state.covariance
    np.testing.assert_array_equal(ahead.growth.grown(other), alone)
    assert np.abs(alone[CLOCK, :NAV_DIM]).max() > 0.0


def test_gate_forgets_an_offset_that_the_drift_carries_away():
    config = replace(FILTER, estimate_time_offset=True)
    state = with_calibration(rest_state(), config)
    calibration, motion = calibration_of(state, config), MotionModel(RunConfig().imu, config, NOISE)
    calibration.learn(OffsetMeasured())
    assert calibration.account(state).gains.max() > 10.0
    ahead = motion.predict(state, resting(1200.0), START_NS + 1_200_000_000_000)
    calibration.grow(ahead.growth)
    assert calibration.account(ahead.state).gains.max() < 1.5


class OffsetMeasured:
    """The clock's offset, to a millisecond."""

    columns, information, gradient = np.array([CLOCK]), np.array([[1e6]]), np.zeros(1)


def test_general_motion_finds_mounting_and_clock_in_a_short_run():
    trial = online_trial("calibration", 1, duration=7.0, config=SMALL)
    assert np.linalg.norm(trial.error[:3]) < np.radians(0.5)
    assert np.linalg.norm(trial.error[3:6]) < 0.05
    assert abs(trial.error[6]) < 0.0015
    assert np.all(np.abs(trial.error[:7]) < 5.0 * np.sqrt(np.diag(trial.covariance)[:7]))
    assert trial.found.kept_names == ("clock drift",)
    assert trial.odometry.core.state.covariance[CALIBRATION, CALIBRATION].shape == (8, 8)


def test_planar_motion_leaves_the_vertical_lever_arm_alone_in_a_short_run():
    trial = online_trial("planar", 1, duration=9.0, config=SMALL)
    assert "lever arm along imu z" in trial.found.kept_names
    assert trial.error[5] == pytest.approx(trial.first_error[5], abs=2e-4)
    assert trial.found.sigma[5] == pytest.approx(trial.prior_sigma[5], rel=1e-2)
    turn = trial.R_imu_lidar @ trial.error[:3]
    assert np.linalg.norm(turn[:2]) < np.radians(0.5)
    assert abs(trial.error[6]) < 0.0015


def test_straight_drive_moves_no_lever_arm_in_a_short_run():
    trial = online_trial("straight", 1, duration=5.0, config=SMALL)
    assert set(trial.found.kept_names) >= {f"lever arm along imu {axis}" for axis in "xyz"}
    np.testing.assert_allclose(trial.error[3:6], trial.first_error[3:6], atol=3e-3)


def test_fast_drift_is_followed_in_a_short_run():
    wide = replace(SMALL, filter=replace(SMALL.filter, time_drift_sigma_ppm=300.0))
    trial = online_trial("calibration", 1, duration=8.0, drift=300e-6, config=wide)
    assert abs(trial.error[6]) < min(0.7e-3, 4.0 * trial.found.sigma[6])


def test_map_of_ones_own_is_begun_anew_and_finds_mounting_and_clock():
    """What the built-in map can, any `LocalMap` can: here one on a k-d tree."""
    few = replace(CONFIG, cloud=replace(CONFIG.cloud, target_points=500))
    cleared = []

    class Counting(NeighbourMap):
        def clear(self):
            cleared.append(True)
            super().clear()

    trial = online_trial("calibration", 1, duration=5.0, config=few, local_map=Counting(spacing=0.15))
    assert len(cleared) > 2
    assert np.linalg.norm(trial.error[:3]) < np.radians(0.7)
    assert np.linalg.norm(trial.error[3:6]) < 0.06
    assert abs(trial.error[6]) < 0.002
    assert so3.log(trial.found.T_imu_lidar[:3, :3]).shape == (3,)
