"""Sensor factors, planes and parts of poses are those of GTSAM's Python wheel where conventions allow.

Its IMU factors measure errors in another chart of the same manifold, and its covariances are of first order in the
step: whitened squared errors agree for small errors and short steps. Directions have another tangent basis there: what
it spans is compared.
"""

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.factors import CombinedImu, LeverArmPosition, PreintegratedImu
from heliograph.graph import Attitude, BearingRange, Between, Isotropic, Plane, Prior
from heliograph.imu import preintegrate
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose, so3

gtsam = pytest.importorskip("gtsam", reason="needs GTSAM: pip install 'heliograph[oracles]'")

ONE, RATE = Isotropic(1.0), 1000
# Walks so weak that the sign of their correlation with the motion, which is wrong there, does not matter.
NOISE = ImuNoise(gyro=2e-3, accel=3e-2, gyro_walk=1e-6, accel_walk=1e-5)
BIAS = np.array([0.03, -0.02, 0.05, 0.2, -0.1, 0.3])
DOWN = np.array([0.0, 0.0, -9.81])


def samples():
    t = np.arange(RATE + 1) / RATE
    gyro = np.stack([0.9 * np.sin(3 * t), 0.7 * np.cos(2 * t), 1.3 * np.sin(1.1 * t + 0.3)], axis=1)
    accel = np.stack([2.5 * np.sin(5 * t), 1.5 * np.cos(4 * t), 9.81 + 1.8 * np.sin(3 * t)], axis=1)
    return ImuBatch(stamps_ns=np.round(1e9 * t).astype(np.int64), gyro=gyro, accel=accel, received_ns=0)


def integrated(kind, params):
    """Hand the readings in the middle of every step to gtsam, forces turned by half a step as ours are."""
    imu, params = samples(), params.MakeSharedU(9.81)
    params.setGyroscopeCovariance(NOISE.gyro**2 * np.eye(3))
    params.setAccelerometerCovariance(NOISE.accel**2 * np.eye(3))
    params.setIntegrationCovariance(1e-16 * np.eye(3))
    if hasattr(params, "setBiasAccCovariance"):
        params.setBiasAccCovariance(NOISE.accel_walk**2 * np.eye(3))
        params.setBiasOmegaCovariance(NOISE.gyro_walk**2 * np.eye(3))
    motion = kind(params, bias_of(BIAS))
    gyro, accel = 0.5 * (imu.gyro[1:] + imu.gyro[:-1]), 0.5 * (imu.accel[1:] + imu.accel[:-1])
    for rate, force, dt in zip(gyro, accel, 1e-9 * np.diff(imu.stamps_ns), strict=True):
        turned = so3.exp(0.5 * dt * (rate - BIAS[:3])) @ (force - BIAS[3:]) + BIAS[3:]
        motion.integrateMeasurement(turned, rate, dt)
    return motion


def bias_of(b):
    return gtsam.imuBias.ConstantBias(b[3:], b[:3])


def ours():
    imu = samples()
    options = {"noise": NOISE, "config": ImuConfig(curvature=0.0), "gyro_bias": BIAS[:3], "accel_bias": BIAS[3:]}
    return preintegrate(imu, int(imu.stamps_ns[0]), int(imu.stamps_ns[-1]), **options)


def small(rng, covariance, size):
    """A drawn error of a few standard deviations."""
    return 2.0 * np.linalg.cholesky(covariance) @ rng.normal(size=size)


def pose_of(X):
    return gtsam.Pose3(gtsam.Rot3(X.matrix[:3, :3]), X.matrix[:3, 3])


def values_of_states(X_i, X_j):
    values = gtsam.Values()
    for key, X in ((0, X_i), (1, X_j)):
        values.insert(key, pose_of(X))
        values.insert(10 + key, X.matrix[:3, 4])
    return values


def squared(factor, *variables):
    """The whitened squared error of a record's only factor."""
    residual = factor.evaluate(*variables)[0][0]
    S = factor.noise.whitening(factor.rows, 1).sqrt_information.reshape(factor.rows, factor.rows)
    return float(((S @ residual) ** 2).sum())


def test_preintegrated_factor_weighs_errors_as_gtsams(rng):
    theirs = integrated(gtsam.PreintegratedImuMeasurements, gtsam.PreintegrationParams)
    motion = ours()
    factor = PreintegratedImu([0], [1], [2], motion, gravity=DOWN)
    reference = gtsam.ImuFactor(0, 10, 1, 11, 2, theirs)
    for _ in range(5):
        X_i = ExtendedPose.exp(rng.normal(size=9))
        bias = BIAS + 1e-4 * rng.normal(size=6)
        X_j = motion.predict(X_i, bias[:3], bias[3:], DOWN)[0].retract(small(rng, motion.covariance[0], 9))
        values = values_of_states(X_i, X_j)
        values.insert(2, bias_of(bias))
        assert squared(factor, X_i, X_j, bias) == pytest.approx(2.0 * reference.error(values), rel=0.03)


def test_combined_factor_weighs_errors_as_gtsams(rng):
    theirs = integrated(gtsam.PreintegratedCombinedMeasurements, gtsam.PreintegrationCombinedParams)
    motion = ours()
    factor = CombinedImu([0], [2], [1], [3], motion, gravity=DOWN)
    reference = gtsam.CombinedImuFactor(0, 10, 1, 11, 2, 3, theirs)
    for _ in range(5):
        X_i = ExtendedPose.exp(rng.normal(size=9))
        drawn = small(rng, motion.combined[0], 15)
        X_j = motion.predict(X_i, BIAS[:3], BIAS[3:], DOWN)[0].retract(drawn[:9])
        values, later = values_of_states(X_i, X_j), BIAS + drawn[9:]
        values.insert(2, bias_of(BIAS))
        values.insert(3, bias_of(later))
        assert squared(factor, X_i, BIAS, X_j, later) == pytest.approx(2.0 * reference.error(values), rel=0.03)


def linear(factor, values, columns):
    """Jacobians of a GTSAM factor, not whitened by more than its unit noise, and its residual."""
    A, b = factor.linearize(values).jacobian()
    keys, out, at = list(factor.keys()), {}, 0
    for key in keys:
        out[key] = A[:, at : at + columns[key]]
        at += columns[key]
    return [out[key] for key in sorted(out)], -b


def test_lever_arm_position_is_gtsams(rng):
    noise, arm = gtsam.noiseModel.Unit.Create(3), rng.normal(size=3)
    for _ in range(5):
        T, z = SE3.exp(rng.normal(size=6)), rng.normal(size=3)
        reference = getattr(gtsam, "".join(["G", "P", "S", "FactorArm"]))(0, z, arm, noise)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(T.matrix))
        (J,), r = linear(reference, values, {0: 6})
        residual, (ours_J,) = LeverArmPosition(0, z, ONE, lever_arm=arm).evaluate(T)
        np.testing.assert_allclose(residual[0], r, atol=1e-12)
        np.testing.assert_allclose(ours_J[0], J, atol=1e-12)
        X = ExtendedPose.from_rotation_position_velocity(T.matrix[:3, :3], T.matrix[:3, 3], rng.normal(size=3))
        residual, (ours_J,) = LeverArmPosition(0, z, ONE, lever_arm=arm).evaluate(X)
        np.testing.assert_allclose(residual[0], r, atol=1e-12)
        np.testing.assert_allclose(ours_J[0], np.hstack([J, np.zeros((3, 3))]), atol=1e-12)


def test_poses_of_extended_poses_are_compared_as_gtsam_compares_poses(rng):
    noise = gtsam.noiseModel.Unit.Create(6)
    for _ in range(5):
        X_i, X_j, Z = (
            ExtendedPose.exp(rng.normal(size=9)),
            ExtendedPose.exp(rng.normal(size=9)),
            SE3.exp(rng.normal(size=6)),
        )
        values = values_of_states(X_i, X_j)
        J, r = linear(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(Z.matrix), noise), values, {0: 6, 1: 6})
        residual, found = Between(0, 1, Z, ONE).evaluate(X_i, X_j)
        np.testing.assert_allclose(residual[0], r, atol=1e-9)
        for mine, their in zip(found, J, strict=True):
            np.testing.assert_allclose(mine[0], np.hstack([their, np.zeros((6, 3))]), atol=1e-9)
        (J,), r = linear(gtsam.PriorFactorPose3(0, gtsam.Pose3(Z.matrix), noise), values, {0: 6})
        residual, (mine,) = Prior(0, Z, ONE).evaluate(X_i)
        np.testing.assert_allclose(residual[0], r, atol=1e-9)
        np.testing.assert_allclose(mine[0], np.hstack([J, np.zeros((6, 3))]), atol=1e-9)


def test_rotation_of_a_pose_is_gtsams_rotation_prior(rng):
    if not hasattr(gtsam, "PoseRotationPrior3D"):
        pytest.skip("this GTSAM has no PoseRotationPrior3D")
    Z, T = SO3.exp(rng.normal(size=3)), SE3.exp(rng.normal(size=6))
    factor = gtsam.PoseRotationPrior3D(
        0, gtsam.Pose3(gtsam.Rot3(Z.matrix), np.zeros(3)), gtsam.noiseModel.Unit.Create(3)
    )
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(T.matrix))
    residual, _ = Prior(0, Z, ONE).evaluate(T)
    assert float((residual**2).sum()) == pytest.approx(2.0 * factor.error(values), rel=1e-9)


def spanned(J):
    return [a.T @ b for a in J for b in J]


def test_bearing_range_in_space_is_gtsams_at_the_measurement(rng):
    noise = gtsam.noiseModel.Unit.Create(3)
    for _ in range(5):
        T, p = SE3.exp(rng.normal(size=6)), rng.normal(scale=3.0, size=3)
        z = S2(T.matrix[:3, :3].T @ (p - T.matrix[:3, 3]))
        factor = gtsam.BearingRangeFactor3D(0, 1, gtsam.Unit3(z.vector), 2.5, noise)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(T.matrix))
        values.insert(1, p)
        theirs, r = linear(factor, values, {0: 6, 1: 3})
        residual, found = BearingRange(0, 1, z, 2.5, ONE).evaluate(T, p)
        np.testing.assert_allclose(residual[0], r, atol=1e-9)
        for mine, their in zip(spanned([J[0] for J in found]), spanned(theirs), strict=True):
            np.testing.assert_allclose(mine, their, atol=1e-7)


def test_bearing_range_in_the_plane_is_gtsams(rng):
    noise, order = gtsam.noiseModel.Unit.Create(2), [1, 2, 0]
    T, p, angle = SE2.exp(rng.normal(size=3)), rng.normal(scale=3.0, size=2), -2.8
    factor = gtsam.BearingRangeFactor2D(0, 1, gtsam.Rot2(angle), 2.5, noise)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2(T.matrix[0, 2], T.matrix[1, 2], np.arctan2(T.matrix[1, 0], T.matrix[0, 0])))
    values.insert(1, p)
    (by_pose, by_point), r = linear(factor, values, {0: 3, 1: 2})
    residual, found = BearingRange(0, 1, SO2.exp([angle]), 2.5, ONE).evaluate(T, p)
    np.testing.assert_allclose(residual[0], r, atol=1e-9)
    np.testing.assert_allclose(found[0][0], by_pose[:, np.argsort(order)], atol=1e-9)
    np.testing.assert_allclose(found[1][0], by_point, atol=1e-9)


def test_plane_is_gtsams_oriented_plane_at_the_measurement(rng):
    """GTSAM writes a plane as n . x + d = 0: its distance is ours with the other sign."""
    noise = gtsam.noiseModel.Unit.Create(3)
    for _ in range(5):
        T, n, d = SE3.exp(rng.normal(size=6)), S2(rng.normal(size=3)), rng.normal()
        seen = gtsam.OrientedPlane3(gtsam.Unit3(n.vector), -d).transform(gtsam.Pose3(T.matrix)).planeCoefficients()
        found, _ = Plane(0, S2(seen[:3]), -seen[3], ONE, plane=(n, d)).evaluate(T)
        np.testing.assert_allclose(found, 0.0, atol=1e-9)
        reference = gtsam.OrientedPlane3Factor([*seen[:3], seen[3] + 0.5], noise, 0, 1)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(T.matrix))
        values.insert(1, gtsam.OrientedPlane3(gtsam.Unit3(n.vector), -d))
        (by_pose, by_plane), _ = linear(reference, values, {0: 6, 1: 3})
        _, (J, by_normal, by_distance) = Plane(0, S2(seen[:3]), -seen[3] - 0.5, ONE, plane=(1, 2)).evaluate(T, n, [d])
        np.testing.assert_allclose(J[0].T @ J[0], by_pose.T @ by_pose, atol=1e-6)
        ours_plane = np.hstack([by_normal[0], by_distance[0]])
        np.testing.assert_allclose(
            np.linalg.svd(J[0].T @ ours_plane)[1], np.linalg.svd(by_pose.T @ by_plane)[1], atol=1e-6
        )


def test_attitude_sees_the_direction_that_gtsam_sees(rng):
    for _ in range(5):
        T, world = SE3.exp(rng.normal(size=6)), S2(rng.normal(size=3))
        body = gtsam.Rot3(T.matrix[:3, :3]).matrix().T @ gtsam.Unit3(world.vector).point3()
        residual, _ = Attitude(0, S2(body), ONE, world=world).evaluate(T)
        np.testing.assert_allclose(residual, 0.0, atol=1e-12)
        off = S2(body).retract(1e-3 * rng.normal(size=2))
        residual, _ = Attitude(0, off, ONE, world=world).evaluate(T)
        theirs = gtsam.Unit3(off.vector).errorVector(gtsam.Unit3(body))
        assert np.linalg.norm(residual) == pytest.approx(np.linalg.norm(theirs), rel=1e-5)
