"""The parts of a calibration: first guess, samples between samples, noise at rest, verdicts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heliograph.calibration.coarse import align_turns
from heliograph.calibration.gather import gather, refined
from heliograph.calibration.lidar_imu import measured_noise
from heliograph.calibration.observability import (
    AXES,
    analyse,
    difference,
    judge_axes,
    kept_in_words,
    prior_sigmas,
    useful_sigmas,
)
from heliograph.config import CalibrationConfig, ImuConfig, RunConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate

CONFIG = CalibrationConfig()
EPOCH = 1_700_000_000_000_000_000


def wave(stamps_ns, seconds_late=0.0):
    """A turning motion, its rate in body axes by differences of exact attitudes."""
    t = (stamps_ns - EPOCH) * 1e-9 - seconds_late
    return Rotation.from_rotvec(
        np.stack([0.5 * np.sin(2.1 * t), 0.4 * np.sin(3.0 * t + 1.0), 0.6 * np.sin(1.4 * t + 2.0)], axis=1)
    )


def sensors(offset, R_imu_lidar, *, axes=(1.0, 1.0, 1.0)):
    """A LiDAR's attitudes and a gyroscope whose stamps are ``offset`` ahead."""

    def attitude(t_ns):
        return Rotation.from_rotvec(wave(t_ns).as_rotvec() * axes)

    stamps = EPOCH + np.arange(0, 12_000_000_000, 5_000_000)
    step = 100_000
    rate = (attitude(stamps - step).inv() * attitude(stamps + step)).as_rotvec() / (2e-9 * step)
    imu = ImuBatch(stamps_ns=stamps + round(1e9 * offset), gyro=rate + 0.01, accel=np.zeros_like(rate), received_ns=0)
    ends = EPOCH + np.arange(500_000_000, 11_500_000_000, 100_000_000)
    return ends, attitude(ends).as_matrix() @ R_imu_lidar, imu


def test_noise_over_a_gap_costs_nothing():
    stamps = EPOCH + np.concatenate([np.arange(400), 2 * 10**14 + np.arange(400)]) * 5_000_000  # 32 years
    imu = ImuBatch(stamps_ns=stamps, gyro=np.ones((800, 3)), accel=np.full((800, 3), 5.6), received_ns=0)
    assert measured_noise(imu, ImuConfig()).gyro > 0.0


def test_turns_tell_offset_and_rotation():
    R = so3.exp([0.3, -0.2, 1.1])
    ends, R_odom_lidar, imu = sensors(0.037, R)
    found = align_turns(ends, R_odom_lidar, imu, R_prior=np.eye(3), sigma_rotation=np.pi, search=0.2, sigma_offset=0.1)
    assert found.offset == pytest.approx(0.037, abs=2e-4)
    assert np.linalg.norm(so3.log(R.T @ found.R_imu_lidar)) < 1e-3
    np.testing.assert_allclose(found.gyro_bias, 0.01, atol=1e-3)


def test_turns_about_one_axis_keep_the_prior_around_it():
    R = so3.exp([0.05, -0.04, 0.3])
    ends, R_odom_lidar, imu = sensors(-0.02, R, axes=(0.0, 0.0, 1.0))
    R_prior = so3.exp([0.0, 0.0, -0.05]) @ R @ so3.exp([0.03, -0.06, 0.0])
    found = align_turns(ends, R_odom_lidar, imu, R_prior=R_prior, sigma_rotation=0.1, search=0.1, sigma_offset=0.03)
    error = so3.log(found.R_imu_lidar @ R.T)
    assert np.linalg.norm(error[:2]) < 2e-3  # told: where the axis points
    assert 0.02 < abs(error[2]) < 0.08  # not told: the turn about it stays about what was believed


def test_samples_between_samples_lie_on_the_motion():
    stamps = EPOCH + np.arange(0, 1_000_000_000, 10_000_000)
    t = (stamps - EPOCH) * 1e-9
    signal = np.stack([np.sin(12.0 * t), np.cos(9.0 * t), t**3], axis=1)
    fine = refined(ImuBatch(stamps_ns=stamps, gyro=signal, accel=2.0 * signal, received_ns=0))
    assert len(fine) == 2 * len(stamps) - 3  # nothing before the second and after the last but one
    late = (fine.stamps_ns - EPOCH) * 1e-9
    exact = np.stack([np.sin(12.0 * late), np.cos(9.0 * late), late**3], axis=1)
    straight = np.max((12.0 * 0.01) ** 2 / 8.0)
    assert np.abs(fine.gyro - exact).max() < 0.03 * straight
    np.testing.assert_allclose(fine.accel, 2.0 * fine.gyro, atol=1e-12)


def test_samples_are_not_put_into_gaps():
    stamps = EPOCH + np.array([0, 10, 20, 30, 40, 90, 100, 110, 120], dtype=np.int64) * 1_000_000
    zeros = np.zeros((len(stamps), 3))
    fine = refined(ImuBatch(stamps_ns=stamps, gyro=zeros, accel=zeros, received_ns=0))
    inserted = np.setdiff1d(fine.stamps_ns, stamps) - EPOCH
    assert inserted.tolist() == [15_000_000, 25_000_000, 105_000_000]


def test_noise_is_measured_at_rest_and_assumed_without_one():
    config = replace(ImuConfig(), gyro_noise_floor=1e-5, accel_noise_floor=1e-4)
    resting = simulate(SCENARIOS["calibration"].varied(walk={"duration": 8.0, "rest": 4.0}), 1)
    gyro, accel = resting.imu()
    imu = ImuBatch(stamps_ns=resting.imu_stamps_ns, gyro=gyro, accel=accel, received_ns=0)
    noise = measured_noise(imu, config)
    assert noise.gyro == pytest.approx(2e-4, rel=0.15)
    assert noise.accel == pytest.approx(2e-3, rel=0.15)
    moving = replace(imu, gyro=gyro + 0.5)
    assert measured_noise(moving, config).gyro == config.gyro_noise


def test_too_little_data_is_one_line():
    ones = np.ones((3, 3))
    with pytest.raises(DataError, match=r"3 inertial samples are too few .* record some 30 s"):
        gather([ImuBatch(stamps_ns=np.arange(3), gyro=ones, accel=ones, received_ns=0)], RunConfig())


def observed_with(known):
    """What is told if each axis is known to ``known`` times its prior sigma, and all are independent."""
    prior = prior_sigmas(CONFIG)
    return analyse(np.diag((known * prior) ** 2), prior, CONFIG.gain)


def test_direction_that_the_data_tell_little_of_keeps_the_prior():
    known = np.array([1e-3, 1e-3, 1.0, 1e-3, 0.9, 1e-3, 1e-3, 1e-3])
    observed = observed_with(known)
    assert observed.kept.sum() == 2
    change = np.arange(1.0, 9.0) * 1e-3
    np.testing.assert_allclose(observed.observed_part(change), change * (known < 0.5), atol=1e-15)
    prior = prior_sigmas(CONFIG)
    expected = np.where(known < 0.5, known * prior, prior)
    np.testing.assert_allclose(np.sqrt(np.diag(observed.covariance)), expected, rtol=1e-9)


def test_verdicts_name_what_was_not_excited_and_how_to_excite_it():
    useful = useful_sigmas(CONFIG) / prior_sigmas(CONFIG)
    known = 0.5 * useful
    known[1], known[5] = 3.0 * useful[1], 1.0
    observed = observed_with(known)
    axes = judge_axes(observed, np.zeros(8), CONFIG)
    assert [axis.name for axis in axes] == list(AXES)
    verdicts = {axis.name: axis.verdict for axis in axes}
    assert verdicts["rotation about y"] == "weak"
    assert verdicts["lever arm along z"] == "not excited"
    assert set(verdicts.values()) == {"observed", "weak", "not excited"}
    assert all((axis.remedy == "") == (axis.verdict == "observed") for axis in axes)
    [line] = kept_in_words(observed, prior_sigmas(CONFIG))
    assert line.startswith("lever arm along (+0.00, +0.00, +1.00): not excited, kept at its prior; turn about")


def test_oblique_direction_is_kept_and_the_axes_are_partly_told():
    prior, axis = prior_sigmas(CONFIG), np.array([0.0, 0.6, 0.8])
    covariance = np.diag((1e-3 * prior) ** 2)
    covariance[3:6, 3:6] += CONFIG.prior_lever**2 * np.outer(axis, axis)
    observed = analyse(covariance, prior, CONFIG.gain)
    assert observed.kept.sum() == 1
    verdicts = [axis.verdict for axis in judge_axes(observed, np.zeros(8), CONFIG)]
    assert verdicts[3:6] == ["observed", "partly", "not excited"]
    assert "lever arm along (+0.00, +0.60, +0.80)" in kept_in_words(observed, prior)[0]


def test_difference_of_mountings_is_along_the_imus_axes():
    before, after = np.eye(4), np.eye(4)
    before[:3, :3] = so3.exp([0.0, 0.0, 1.0])
    after[:3, :3] = so3.exp([0.2, 0.0, 0.0]) @ before[:3, :3]
    after[:3, 3] = [0.0, 0.0, 0.5]
    np.testing.assert_allclose(difference(before, after), [0.2, 0, 0, 0, 0, 0.5], atol=1e-12)
