"""Preintegrated motions and their covariances are those of GTSAM's Python wheel, on the same data.

GTSAM holds a reading over a step and pushes along the attitude at the step's start; ours pushes along the attitude in
its middle. Given forces turned by that half step it must do the same arithmetic, to rounding; its covariances, which it
propagates to first order in the step, approach ours as the steps become short.
"""

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.imu import preintegrate
from heliograph.lie import ExtendedPose, se23, so3

gtsam = pytest.importorskip("gtsam", reason="needs GTSAM: pip install 'heliograph[oracles]'")

NOISE = ImuNoise(gyro=2e-3, accel=3e-2, gyro_walk=3e-3, accel_walk=2e-2)
CONFIG = ImuConfig(curvature=0.0)
SECONDS = 1.2


def samples(rate, scale=1.0):
    t = np.arange(round(SECONDS * rate) + 1) / rate
    gyro = scale * np.stack([0.9 * np.sin(3 * t), 0.7 * np.cos(2 * t), 1.3 * np.sin(1.1 * t + 0.3)], axis=1)
    accel = np.stack([2.5 * np.sin(5 * t), 1.5 * np.cos(4 * t), 9.81 + 1.8 * np.sin(3 * t)], axis=1)
    return ImuBatch(stamps_ns=np.round(1e9 * t).astype(np.int64), gyro=gyro, accel=accel, received_ns=0)


def configured(cls):
    params = cls.MakeSharedU(9.81)
    params.setGyroscopeCovariance(NOISE.gyro**2 * np.eye(3))
    params.setAccelerometerCovariance(NOISE.accel**2 * np.eye(3))
    params.setIntegrationCovariance(1e-16 * np.eye(3))
    if hasattr(params, "setBiasAccCovariance"):
        params.setBiasAccCovariance(NOISE.accel_walk**2 * np.eye(3))
        params.setBiasOmegaCovariance(NOISE.gyro_walk**2 * np.eye(3))
    return params


def integrated(kind, params, imu, bias):
    """Hand the readings in the middle of every step to gtsam, forces turned by half a step."""
    motion = kind(configured(params), gtsam.imuBias.ConstantBias(bias[3:], bias[:3]))
    gyro, accel = 0.5 * (imu.gyro[1:] + imu.gyro[:-1]), 0.5 * (imu.accel[1:] + imu.accel[:-1])
    for rate, force, dt in zip(gyro, accel, 1e-9 * np.diff(imu.stamps_ns), strict=True):
        turned = so3.exp(0.5 * dt * (rate - bias[:3])) @ (force - bias[3:]) + bias[3:]
        motion.integrateMeasurement(turned, rate, dt)
    return motion


def ours(imu, bias):
    return preintegrate(
        imu,
        int(imu.stamps_ns[0]),
        int(imu.stamps_ns[-1]),
        noise=NOISE,
        config=CONFIG,
        gyro_bias=bias[:3],
        accel_bias=bias[3:],
    )


BIAS = np.array([0.03, -0.02, 0.05, 0.2, -0.1, 0.3])


def test_motion_is_gtsams():
    imu = samples(400)
    theirs = integrated(gtsam.PreintegratedImuMeasurementsManifold, gtsam.PreintegrationParams, imu, BIAS)
    motion = ours(imu, BIAS)
    np.testing.assert_allclose(motion.delta_R[0], theirs.deltaRij().matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(motion.delta_p[0], theirs.deltaPij(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(motion.delta_v[0], theirs.deltaVij(), rtol=0, atol=1e-12)
    assert motion.duration_s[0] == pytest.approx(theirs.deltaTij(), abs=1e-9)


def relative(found, expected):
    sigma = np.sqrt(np.diag(expected))
    return np.abs(found - expected) / np.outer(sigma, sigma)


@pytest.mark.parametrize("rate", [200, 1000])
def test_covariance_approaches_gtsams(rate):
    imu = samples(rate)
    theirs = integrated(gtsam.PreintegratedImuMeasurementsManifold, gtsam.PreintegrationParams, imu, BIAS)
    found = relative(ours(imu, BIAS).covariance[0], theirs.preintMeasCov())
    assert found.max() < 4.0 / rate


def combined(rate):
    """Return our combined covariance, gtsam's in our coordinates, and the motions."""
    imu = samples(rate)
    theirs = integrated(gtsam.PreintegratedCombinedMeasurements, gtsam.PreintegrationCombinedParams, imu, BIAS)
    motion = ours(imu, BIAS)
    # Its rows: rotation vector, position and velocity in the first frame, accelerometer bias, gyro bias.
    to_ours = np.zeros((15, 15))
    to_ours[:3, :3] = so3.right_jacobian(so3.log(motion.delta_R[0]))
    to_ours[3:6, 3:6] = to_ours[6:9, 6:9] = motion.delta_R[0].T
    to_ours[9:12, 12:] = to_ours[12:, 9:12] = np.eye(3)
    return motion.combined[0], to_ours @ theirs.preintMeasCov() @ to_ours.T, motion, theirs


@pytest.mark.parametrize("rate", [200, 1000])
def test_combined_covariance_approaches_gtsams_but_for_a_sign(rate):
    expected, found, _, _ = combined(rate)
    found[:9, 9:] *= -1.0  # the next test shows which sign is right
    found[9:, :9] *= -1.0
    assert relative(expected, found).max() < 6.0 / rate


def test_drawn_motions_correlate_with_biases_as_ours_say(rng):
    """GTSAM's own residual, over drawn motions: prediction less truth, first bias less second."""
    expected, found, motion, theirs = combined(200)
    factor = gtsam.CombinedImuFactor(0, 1, 2, 3, 4, 5, theirs)
    identity, bias = gtsam.Pose3(), gtsam.imuBias.ConstantBias(BIAS[3:], BIAS[:3])
    drawn = rng.multivariate_normal(np.zeros(15), expected, size=400)  # which drawn noise has confirmed, in tests/unit
    start, residuals = gtsam.NavState(identity, np.zeros(3)), []
    predicted = theirs.predict(start, bias)
    for row in drawn:
        truth = se23.retract(motion.delta.matrix[0], row[:9])
        offset = truth[:3, 3:] - motion.delta.matrix[0, :3, 3:]
        pose = gtsam.Pose3(gtsam.Rot3(truth[:3, :3]), predicted.pose().translation() + offset[:, 0])
        later = gtsam.imuBias.ConstantBias(BIAS[3:] + row[12:], BIAS[:3] + row[9:12])
        velocity = predicted.velocity() + offset[:, 1]
        residuals.append(factor.evaluateError(identity, np.zeros(3), pose, velocity, bias, later))
    seen = np.corrcoef(np.array(residuals).T)
    assert seen[2, 14] == pytest.approx(expected[2, 11] / np.sqrt(expected[2, 2] * expected[11, 11]), abs=0.15)
    assert np.sign(found[2, 11]) == -np.sign(seen[2, 14])


def test_prediction_at_another_bias_is_gtsams_to_second_order():
    imu = samples(400)
    theirs = integrated(gtsam.PreintegratedImuMeasurementsManifold, gtsam.PreintegrationParams, imu, BIAS)
    change = 1e-3 * np.array([1.0, -2.0, 1.5, 5.0, 3.0, -4.0])
    bias = BIAS + change
    start = gtsam.NavState(gtsam.Pose3(), np.array([1.0, 2.0, 3.0]))
    state = theirs.predict(start, gtsam.imuBias.ConstantBias(bias[3:], bias[:3]))
    X = ExtendedPose.from_rotation_position_velocity(np.eye(3), np.zeros(3), [1.0, 2.0, 3.0])
    found = ours(imu, BIAS).predict(X, bias[:3], bias[3:], (0.0, 0.0, -9.81))
    np.testing.assert_allclose(found.rotation[0], state.pose().rotation().matrix(), rtol=0, atol=2e-6)
    np.testing.assert_allclose(found.position[0], state.pose().translation(), rtol=0, atol=5e-5)
    np.testing.assert_allclose(found.velocity[0], state.velocity(), rtol=0, atol=1e-4)
