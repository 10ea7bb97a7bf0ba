"""Calibration from poses of known noise: errors, honest sigmas, and what a motion in the plane cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from calibration_trials import CONFIG, POSE_SIGMA, nees_band, pose_trial

SHORT = {"walk": {"duration": 9.0}, "period_ns": 200_000_000}
BARS = np.array([*[np.radians(0.2)] * 3, *[0.01] * 3, 5e-4])


def mean_nees(trials):
    told = sum(trial.told for trial in trials)
    return sum(trial.nees for trial in trials) / len(trials), nees_band(told, len(trials), share=0.99)


def test_calibration_after_general_motion_finds_everything_to_the_bars():
    trial = pose_trial("calibration", 3, walk={"duration": 12.0})
    assert trial.told == 8
    assert np.all(np.abs(trial.error[:7]) < BARS)
    assert abs(trial.error[7]) < 20e-6
    assert trial.result.converged


def test_calibration_finds_the_size_of_the_poses_noise():
    found = pose_trial("calibration", 4, walk={"duration": 12.0}).result.estimate.poses.covariance
    sigma = np.sqrt(np.diagonal(found, axis1=1, axis2=2).mean(axis=0))
    np.testing.assert_allclose(sigma, POSE_SIGMA, rtol=0.2)


@pytest.mark.parametrize("passes", [2, 6])  # the second holds what the first did not see excited, and must know it
def test_calibration_in_the_plane_keeps_the_lever_arm_along_the_turning_axis(passes):
    config = replace(CONFIG, calibration=replace(CONFIG.calibration, passes=passes))
    trial = pose_trial("planar", 2, walk={"duration": 16.0}, config=config)
    assert trial.told == 7
    np.testing.assert_allclose(np.abs(np.diag(trial.kept)[3:6]), [0.0, 0.0, 1.0], atol=0.01)
    assert np.all(np.abs(trial.error[[0, 1, 2, 6]]) < BARS[[0, 1, 2, 6]])
    assert np.linalg.norm(trial.error[3:6]) < 0.01


def test_calibration_in_the_plane_with_a_tilted_imu_keeps_an_oblique_direction():
    trial = pose_trial("planar", 2, walk={"duration": 13.0}, mount={"imu_rpy_deg": (0.0, 30.0, 0.0)})
    values, vectors = np.linalg.eigh(trial.kept[3:6, 3:6])
    np.testing.assert_allclose(values, [0.0, 0.0, 1.0], atol=0.02)
    axis = vectors[:, 2] * np.sign(vectors[2, 2])
    np.testing.assert_allclose(axis, [-0.5, 0.0, np.sqrt(0.75)], atol=0.02)


def test_calibration_at_rest_keeps_all_of_the_prior():
    trial = pose_trial("calibration", 1, walk={"rest": 30.0, "duration": 5.0})
    assert trial.told <= 2  # which way is up ties two turns of the mounting, loosely or not at all
    assert np.trace(trial.kept[3:8, 3:8]) == pytest.approx(5.0, abs=0.05)


def test_calibration_sigmas_are_honest_over_twenty_trials():
    mean, (low, high) = mean_nees([pose_trial("calibration", seed, **SHORT) for seed in range(20)])
    assert low < mean < high


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["calibration", "planar"])
def test_calibration_sigmas_are_honest_over_a_hundred_trials(scenario):
    trials = [pose_trial(scenario, seed, period_ns=200_000_000) for seed in range(100)]
    mean, _ = mean_nees(trials)
    low, high = nees_band(sum(trial.told for trial in trials), len(trials))
    assert low < mean < high
    errors = np.abs(np.array([trial.error for trial in trials]))
    within = np.all(errors[:, [0, 1, 2, 6]] < BARS[[0, 1, 2, 6]], axis=1)
    within &= np.linalg.norm(errors[:, 3:6], axis=1) < 0.01
    # In the plane the turn about the axis of turning has a sigma of 0.08 deg here: one in a hundred may miss the bar.
    assert np.count_nonzero(within) >= 99
