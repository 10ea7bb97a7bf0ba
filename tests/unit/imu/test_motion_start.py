"""Gravity, velocities and biases of what never rested, and whether their covariance is honest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.data import Trajectory
from heliograph.errors import DataError
from heliograph.imu.motion_start import _measurements
from heliograph.lie import se3, so3
from moving import CONFIG, ROAD, ROOM, Trial
from states import GRAVITY

PARTS = {"all": slice(0, 17), "velocity": slice(6, 9), "gyro": slice(9, 12), "accel": slice(12, 15), "g": slice(15, 17)}


def band(dof, count):
    """Two-sided 99.9 % interval of the mean of ``count`` chi-square draws."""
    return chi2.ppf([0.0005, 0.9995], dof * count) / count


@pytest.fixture(scope="module", params=["hand-held", "constant speed"])
def trials(request):
    scenario, begin = (ROOM, 6.0) if request.param == "hand-held" else (ROAD, 6.5)
    return [Trial(seed, scenario, begin=begin) for seed in range(40)]


@pytest.mark.parametrize("part", PARTS)
def test_errors_fit_the_covariance(trials, part):
    dof = PARTS[part].stop - PARTS[part].start
    low, high = band(dof, len(trials))
    assert low < np.mean([trial.nees(PARTS[part]) for trial in trials]) < high


def test_misfit_is_one_where_the_noise_is_what_it_claims(trials):
    assert np.mean([trial.found.misfit for trial in trials]) == pytest.approx(1.0, abs=0.06)
    assert all(trial.found.iterations <= 5 for trial in trials)


def test_covariance_notices_poses_that_are_half_as_good():
    """The measure itself can fail."""
    doubled = [Trial(seed) for seed in range(12)]
    for trial in doubled:
        trial.covariance = trial.covariance / 4.0
        trial.found = trial.align()
    assert np.mean([trial.nees(PARTS["all"]) for trial in doubled]) > 1.5 * band(17, 12)[1]


def test_without_noise_everything_is_exact():
    for body in ("lidar", "imu"):
        trial = Trial(
            3, body=body, quiet=0.0, scale=1.02, scale_sigma=0.05, config=replace(CONFIG, accel_bias_sigma=5.0)
        )
        assert trial.found.verdict == "good"
        np.testing.assert_allclose(trial.error[0:3], 0.0, atol=1e-4)
        np.testing.assert_allclose(trial.error[6:9], 0.0, atol=2e-3)
        np.testing.assert_allclose(trial.error[9:12], 0.0, atol=1e-4)
        np.testing.assert_allclose(trial.error[15:17], 0.0, atol=2e-3)
        assert abs(trial.error[17]) < 2e-3
        assert trial.found.misfit < 0.5


def test_constant_speed_leaves_tilt_and_bias_open_together():
    """On a straight road one number is seen, the sum of both: the prior splits it, and the covariance says so."""
    trial = Trial(1, ROAD, begin=6.5)
    found = trial.found
    assert {"accelerometer bias x", "accelerometer bias y"} <= set(found.unobservable)
    sigma = np.sqrt(np.diag(found.covariance))
    correlation = found.covariance[12:15, 15:17] / np.outer(sigma[12:15], sigma[15:17])
    assert np.abs(correlation).max() > 0.9
    assert found.gravity_sigma == pytest.approx(CONFIG.accel_bias_sigma / GRAVITY, rel=0.05)
    assert found.verdict == "fair"
    assert found.velocity_sigma < 0.02
    # The prior on the bias is all that separates them: four times wider, four times the tilt.
    wide = trial.align(config=replace(CONFIG, accel_bias_sigma=4.0 * CONFIG.accel_bias_sigma))
    assert wide.gravity_sigma == pytest.approx(4.0 * found.gravity_sigma, rel=0.05)
    assert wide.verdict == "poor"


def test_turning_tells_tilt_from_bias():
    found = Trial(1).found
    assert found.verdict == "good"
    assert found.unobservable == ()
    assert found.excitation.turned > np.radians(30.0)
    assert (found.accel_bias_sigma < 0.3 * CONFIG.accel_bias_sigma).all()


def test_scale_is_found_where_the_motion_shows_it_and_named_where_not():
    known, errors, sigmas = ROOM.varied(imu={"accel_bias": 0.01}), [], []
    for seed in range(12):
        trial = Trial(seed, known, scale=1.03, scale_sigma=0.05, config=replace(CONFIG, accel_bias_sigma=0.01))
        errors.append(trial.error[17])
        sigmas.append(trial.found.covariance[17, 17] ** 0.5)
        assert "accelerometer scale" not in trial.found.unobservable
    assert np.mean(np.square(errors) / np.square(sigmas)) < 3.0
    unsure = Trial(1, ROAD, begin=6.5, scale_sigma=0.005).found
    assert "accelerometer scale" in unsure.unobservable
    assert Trial(1).found.accel_scale == pytest.approx(1.0, abs=1e-6)


def test_a_start_while_falling_finds_gravity():
    """A jump: for a third of the time the accelerometer reads next to nothing."""
    jump = ROOM.varied(gait={"frequency": 1.05, "bounce": 0.27})
    trial = Trial(2, jump)
    assert np.linalg.norm(trial.imu.accel, axis=1).min() < 2.0
    assert trial.found.verdict == "good"
    assert trial.nees(PARTS["g"]) < chi2.ppf(0.999, 2)


def test_poses_and_imu_of_different_bodies_contradict_each_other():
    trial = Trial(1)
    swapped = replace(trial.imu, gyro=trial.imu.gyro[:, [1, 0, 2]])
    found = trial.align(imu=swapped)
    assert found.verdict == "failed"
    assert "contradict" in found.reason or "settled" in found.reason
    forgotten = trial.align(T_imu_lidar=se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 0.5), np.zeros(3)))
    assert forgotten.verdict == "failed"


def test_strained_data_widen_their_covariance():
    trial = Trial(1)
    trial.covariance = trial.covariance / 9.0
    found = trial.align()
    assert found.misfit > 4.0
    assert found.verdict in ("fair", "poor")
    assert found.gravity_sigma > 0.8 * Trial(1).found.gravity_sigma


def test_the_wanted_instant_comes_first():
    trial = Trial(1)
    assert trial.found.stamps_ns[0] == trial.begin_ns
    assert len(trial.found.stamps_ns) == len(trial.poses) + 1
    later = trial.align(begin_ns=None)
    np.testing.assert_array_equal(later.stamps_ns, trial.stamps)
    np.testing.assert_allclose(later.v_odom, trial.found.v_odom[1:], atol=1e-4)


def test_what_cannot_be_aligned_is_refused():
    trial = Trial(1)
    few = Trajectory(stamps_ns=trial.stamps[:2], T_frame_body=trial.poses.T_frame_body[:2], body="lidar")
    twice = replace(trial.poses, stamps_ns=np.repeat(trial.stamps[::2], 2)[: len(trial.stamps)])
    empty = replace(trial.imu, stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)))
    with pytest.raises(DataError, match="2 poses; at least 3"):
        trial.align(poses=few)
    with pytest.raises(DataError, match="same stamp"):
        trial.align(poses=twice)
    with pytest.raises(DataError, match="0 IMU samples"):
        trial.align(imu=empty)
    with pytest.raises(DataError, match="need the mounting"):
        trial.align(T_imu_lidar=None)
    trial.covariance = np.eye(6)
    with pytest.raises(DataError, match="covariances of shape"):
        trial.align()


def test_a_pose_of_the_lidar_swings_the_imu_on_its_lever_arm(rng):
    """Eq. (2) against draws."""
    T_imu_lidar = se3.from_rotation_translation(so3.exp([0.3, -0.5, 0.9]), np.array([0.6, -0.3, 0.2]))
    T = np.tile(se3.exp(rng.normal(size=6)), (3, 1, 1))
    root = np.diag(np.repeat([2e-3, 2e-2], 3)) @ rng.uniform(0.2, 1.0, (6, 6))
    P = root @ root.T + np.diag(np.repeat([1e-6, 1e-4], 3))
    poses = Trajectory(stamps_ns=np.arange(3) * 100_000_000, T_frame_body=T, body="lidar")
    _, (R, p, information) = _measurements(poses, np.tile(P, (3, 1, 1)), T_imu_lidar, None)
    np.testing.assert_allclose(R[0], T[0, :3, :3] @ T_imu_lidar[:3, :3].T, atol=1e-12)
    draws = rng.multivariate_normal(np.zeros(6), P, size=4000)
    moved = T[:1] @ se3.from_rotation_translation(so3.exp(draws[:, :3]), np.zeros((len(draws), 3)))
    moved[:, :3, 3] += draws[:, 3:]
    imu = moved @ se3.inverse(T_imu_lidar)
    errors = np.hstack([so3.log(R[0].T @ imu[:, :3, :3]), imu[:, :3, 3] - p[0]])
    np.testing.assert_allclose(np.cov(np.linalg.cholesky(information[0]).T @ errors.T), np.eye(6), atol=0.1)
