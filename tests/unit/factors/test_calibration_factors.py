"""The factors of a calibration: the law of factors, and that the truth has no residual."""

import numpy as np

from heliograph.factors import CalibrationPrior, LidarPose
from heliograph.lie import se3, se23, so3
from heliograph.testing import assert_factor


def pose_data(rng, count):
    return [se3.exp(rng.normal(size=(count, 6))), rng.normal(size=(count, 3)), rng.normal(size=count)]


def test_lidar_pose_obeys_the_law_of_factors(rng):
    assert_factor(LidarPose, rng, pose_data)


def test_calibration_prior_obeys_the_law_of_factors(rng):
    # Errors of up to 3 rad about the axes: differences of the logarithm are best told away from half a turn.
    assert_factor(
        CalibrationPrior,
        rng,
        lambda rng, count: [se3.exp(0.3 * rng.normal(size=(count, 6))), rng.normal(size=(count, 2))],
        tolerance=1e-4,
    )


def test_lidar_pose_of_the_truth_has_no_residual(rng):
    """A body that turns and moves steadily, seen by a LiDAR whose stamps are late and drift."""
    omega, E = np.array([0.3, -0.8, 0.5]), se3.exp([0.1, 0.2, -0.3, 0.4, 0.1, -0.2])
    span = np.array([-10.0, 3.0, 12.0])
    later = 0.004 + 30e-6 * span
    R = so3.exp(rng.normal(size=(3, 3)))
    p, v = rng.normal(size=(2, 3, 3))
    X = se23.from_rotation_position_velocity(R, p, v)
    seen = se3.from_rotation_translation(R @ so3.exp(later[:, None] * omega), p + later[:, None] * v) @ E
    clock = np.tile([0.004, 30e-6], (3, 1))
    data = (np.tile(E, (3, 1, 1)), clock, seen, np.tile(omega, (3, 1)), span)
    np.testing.assert_allclose(LidarPose.residual(X, *data), 0.0, atol=1e-12)
    wrong = LidarPose.residual(X, data[0], 0.0 * clock, *data[2:])
    np.testing.assert_allclose(np.linalg.norm(wrong[:, :3], axis=1), np.abs(later) * np.linalg.norm(omega), rtol=1e-9)


def test_calibration_prior_counts_turns_about_the_imus_axes():
    E_0 = se3.exp([0.0, 0.0, np.pi / 2, 1.0, 2.0, 3.0])[None]
    E = E_0.copy()
    E[0, :3, :3] = so3.exp([0.1, 0.0, 0.0]) @ E_0[0, :3, :3]
    E[0, :3, 3] += [0.0, 0.2, 0.0]
    residual = CalibrationPrior.residual(E, np.array([[2e-3, 1e-6]]), E_0, np.zeros((1, 2)))
    np.testing.assert_allclose(residual[0], [0.1, 0, 0, 0, 0.2, 0, 2e-3, 1e-6], atol=1e-12)
