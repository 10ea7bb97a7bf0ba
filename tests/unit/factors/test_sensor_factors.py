"""Every sensor's factor, in all its variants: residuals of the twins, derivatives at large errors, and refusals."""

import os
import subprocess
import sys

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.factors import (
    AnchoredPosition,
    CalibrationPrior,
    CombinedImu,
    GravityDirection,
    GravityVector,
    LeverArmPosition,
    LidarPose,
    MeanForce,
    PreintegratedImu,
    ScaledMotion,
    Velocity,
)
from heliograph.graph import Isotropic
from heliograph.imu import preintegrate
from heliograph.lie import S2, SE3, ExtendedPose, se3, se23, so3
from native_records import assert_record, part
from reference import sensors as twin
from reference.motion_rows import motion_rows
from states import GRAVITY, NOISE, START_NS, random_imu

COUNT, RANGE = 3, slice(78, 80)  # columns that say how wide the linear range is
ONE = Isotropic(1.0)


def motions(rng, count=COUNT):
    starts = START_NS + rng.integers(0, 10**9, count)
    ends = starts + rng.integers(2 * 10**8, 10**9, count)
    biases = {"gyro_bias": rng.normal(size=(count, 3)), "accel_bias": rng.normal(size=(count, 3))}
    return preintegrate(random_imu(rng, duration=3.0), starts, ends, noise=NOISE, **biases)


def poses(rng, extended=True):
    turns = rng.normal(size=(COUNT, 3))
    turns *= rng.uniform(0.0, 3.0, size=(COUNT, 1)) / np.linalg.norm(turns, axis=1, keepdims=True)
    d = np.hstack([turns, rng.normal(scale=5.0, size=(COUNT, 6 if extended else 3))])
    return ExtendedPose.exp(d) if extended else SE3.exp(d)


def gravity_of(kind, rng):
    """What the constructor is given, the variables, and gravity (N, 3) of their arrays."""
    if kind == "direction":
        return GravityDirection(key=99, magnitude=GRAVITY), [S2(rng.normal(size=(COUNT, 3)))], lambda d: GRAVITY * d
    if kind == "vector":
        return GravityVector(key=99), [rng.normal(scale=GRAVITY, size=(COUNT, 3))], lambda g: g
    g = rng.normal(scale=GRAVITY, size=3)
    return g, [], lambda: g


def near(rng, motion, X_i, bias, g, angle=2.0):
    """States at the end whose errors are large, but less than half a turn."""
    error = np.hstack([rng.normal(size=(COUNT, 3)), rng.normal(scale=10.0, size=(COUNT, 6))])
    error[:, :3] *= angle / np.linalg.norm(error[:, :3], axis=1, keepdims=True)
    ends = []
    for k in range(COUNT):
        at = motion[k : k + 1].corrected(bias[k : k + 1, :3], bias[k : k + 1, 3:])
        ends.append(at.predict(X_i[k], bias[k, :3], bias[k, 3:], g[k]).matrix.reshape(5, 5))
    return ExtendedPose(np.stack(ends)).retract(error)


@pytest.mark.parametrize("kind", ["known", "direction", "vector"])
@pytest.mark.parametrize("walk", [False, True])
def test_inertial_factor_is_its_twin_to_first_order(rng, walk, kind):
    motion, keys = motions(rng), np.arange(COUNT)
    given, variables, of = gravity_of(kind, rng)
    g = np.array([of(*[np.asarray(getattr(v, "vector", v))[k] for v in variables]) for k in range(COUNT)])
    X_i = poses(rng)
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + 0.5 * rng.normal(size=(COUNT, 6))
    X_j, later = near(rng, motion, X_i, bias, g), rng.normal(size=(COUNT, 6))
    rows = motion_rows(motion)
    options = {"gravity": given, "keep_samples": False}
    if walk:
        factor = CombinedImu(keys, 10 + keys, 20 + keys, 30 + keys, motion, **options)

        def residual(k, X_i, b_i, X_j, b_j, *down):
            expected = twin.corrected_motion(rows[k], b_i)
            return np.concatenate([twin.inertial_residual(X_i, X_j, expected, rows[k], of(*down)), b_j - b_i])

        assert_record(factor, [X_i, bias, X_j, later, *variables], residual, exact=1e-8)
    else:
        factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, **options)

        def residual(k, X_i, X_j, b, *down):
            return twin.inertial_residual(X_i, X_j, twin.corrected_motion(rows[k], b), rows[k], of(*down))

        assert_record(factor, [X_i, X_j, bias, *variables], residual, exact=1e-8)


def integrated(motion, k, bias):
    found = preintegrate(
        motion.imu,
        motion.start_ns[k : k + 1],
        motion.end_ns[k : k + 1],
        noise=NOISE,
        gyro_bias=bias[None, :3],
        accel_bias=bias[None, 3:],
    )
    return found.delta.matrix[0]


@pytest.mark.parametrize("kind", ["known", "direction", "vector"])
def test_outside_the_linear_range_the_factor_is_its_twin_integrated_anew(rng, kind):
    motion, keys = motions(rng), np.arange(COUNT)
    given, variables, of = gravity_of(kind, rng)
    g = np.array([of(*[np.asarray(getattr(v, "vector", v))[k] for v in variables]) for k in range(COUNT)])
    X_i, rows = poses(rng), motion_rows(motion)
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + 0.5 * rng.normal(size=(COUNT, 6))
    factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=given)

    def residual(k, X_i, X_j, b, *down):
        return twin.inertial_residual(X_i, X_j, integrated(motion, k, b), rows[k], of(*down))

    assert_record(factor, [X_i, near(rng, motion, X_i, bias, g), bias, *variables], residual, exact=1e-8)


def test_between_both_the_factor_passes_smoothly(rng):
    """Where a |dg|^2 is between 1 and 2, residuals lie between the first order and the exact ones, by a cubic."""
    motion, keys, g = motions(rng), np.arange(COUNT), rng.normal(size=3)
    X_i, rows = poses(rng), motion_rows(motion)
    change = 0.3 * rng.normal(size=(COUNT, 6))
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + change
    factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=g)
    width = np.stack([1.4 / (change[:, :3] ** 2).sum(axis=1), np.zeros(COUNT)], axis=1)
    measurement = factor.measurement.copy()
    measurement[:, RANGE] = width
    factor = part(factor, keys, measurement=measurement)

    def residual(k, X_i, X_j, b):
        first, exact = (
            twin.inertial_residual(X_i, X_j, motion_k, rows[k], g)
            for motion_k in (twin.corrected_motion(rows[k], b), integrated(motion, k, b))
        )
        t = np.clip(width[k, 0] * ((b - rows[k, 18:24])[:3] ** 2).sum() - 1.0, 0.0, 1.0)
        return first + t * t * (3.0 - 2.0 * t) * (exact - first)

    X_j = near(rng, motion, X_i, bias, np.tile(g, (COUNT, 1)))
    assert_record(factor, [X_i, X_j, bias], residual, exact=1e-8)


def test_half_a_turn_of_the_correction_does_not_break_the_first_order(rng):
    """Corrections of 2.9 and 4 rad: beyond 3 rad another way of computing them takes over."""
    motion, keys = motions(rng), np.arange(COUNT)
    rows = motion_rows(motion)
    for angle in (2.9, 4.0):
        change = np.zeros((COUNT, 6))
        for k in range(COUNT):
            J = rows[k, 24:78].reshape(9, 6)[:3, :3]
            axis = rng.normal(size=3)
            change[k, :3] = np.linalg.solve(J, angle * axis / np.linalg.norm(axis))
        bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + change
        X_i = poses(rng)
        X_j = ExtendedPose(X_i.matrix @ np.stack([twin.corrected_motion(rows[k], bias[k]) for k in range(COUNT)]))
        X_j = X_j.retract(0.3 * rng.normal(size=(COUNT, 9)))
        factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=np.zeros(3), keep_samples=False)
        fixed = np.zeros(3)

        def residual(k, X_i, X_j, b, fixed=fixed):
            return twin.inertial_residual(X_i, X_j, twin.corrected_motion(rows[k], b), rows[k], fixed)

        moved = X_i.matrix.copy()
        moved[:, :3, 4] = 0.0
        X_i = ExtendedPose(moved)
        assert_record(factor, [X_i, X_j, bias], residual, tolerance=1e-5, exact=1e-7)


@pytest.mark.parametrize("extended", [False, True])
def test_lever_arm_position_is_its_twin(rng, extended):
    T, arm, z, keys = poses(rng, extended), rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3)), np.arange(COUNT)
    known = LeverArmPosition(keys, z, ONE, lever_arm=arm)
    assert_record(known, [T], lambda k, T: twin.lever_arm(T, arm[k], z[k]))
    variable = LeverArmPosition(keys, z, ONE, arm_key=10 + keys)
    assert_record(variable, [T, arm], lambda k, T, arm: twin.lever_arm(T, arm, z[k]))


@pytest.mark.parametrize("extended", [False, True])
def test_anchored_position_is_its_twin(rng, extended):
    T, arm, z, keys = poses(rng, extended), rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3)), np.arange(COUNT)
    frame, offset = poses(rng, False), rng.normal(size=(COUNT, 3))
    known = AnchoredPosition(keys, 10 + keys, z, ONE, offset=offset)
    assert_record(known, [T, frame], lambda k, T, E: twin.anchored_position(T, E, offset[k], z[k]))
    variable = AnchoredPosition(keys, 10 + keys, z, ONE, offset=offset, arm_key=20 + keys)
    assert_record(variable, [T, frame, arm], lambda k, T, E, arm: twin.anchored_position(T, E, offset[k] + arm, z[k]))


@pytest.mark.parametrize("extended", [False, True])
def test_scaled_motion_is_its_twin(rng, extended):
    T_i, T_j, keys = poses(rng, extended), poses(rng, extended), np.arange(COUNT)
    arm, d, scale = rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3)), rng.uniform(0.9, 1.1, (COUNT, 1))
    factor = ScaledMotion(keys, 10 + keys, 20 + keys, d, ONE, lever_arm=arm)
    assert_record(factor, [T_i, T_j, scale], lambda k, i, j, s: twin.scaled_motion(i, j, s, arm[k], d[k]))


@pytest.mark.parametrize("extended", [False, True])
def test_mean_force_is_its_twin(rng, extended):
    T, keys, up, bias, z = poses(rng, extended), np.arange(COUNT), *rng.normal(scale=5.0, size=(3, COUNT, 3))
    turning = rng.normal(size=(COUNT, 3, 3))
    factor = MeanForce(keys, 10 + keys, 20 + keys, z, turning, ONE)
    assert_record(factor, [T, up, bias], lambda k, T, u, b: twin.mean_force(T, u, b, z[k], turning[k]))
    with pytest.raises(GraphError, match=r"a force \(3,\) and a turning \(3, 3\)"):
        MeanForce(keys, 10 + keys, 20 + keys, z, turning[:2], ONE)


def test_velocity_is_its_twin(rng):
    z = rng.normal(size=(COUNT, 3))
    assert_record(Velocity(np.arange(COUNT), z, ONE), [poses(rng)], lambda k, X: X[:3, 4] - z[k])


def test_lidar_pose_is_its_twin(rng):
    keys, Z, omega, span = np.arange(COUNT), poses(rng, False), rng.normal(size=(COUNT, 3)), rng.normal(size=COUNT)
    factor = LidarPose(keys, 10 + keys, 20 + keys, Z, omega, span, ONE)
    X = poses(rng)
    E, clock = SE3.exp(0.5 * rng.normal(size=(COUNT, 6))), rng.normal(size=(COUNT, 2))
    later = clock[:, 0] + span * clock[:, 1]
    X = ExtendedPose(
        se23.from_rotation_position_velocity(
            Z.rotation @ so3.exp(rng.normal(size=(COUNT, 3))) @ so3.exp(-later[:, None] * omega),
            X.position,
            X.velocity,
        )
    )
    assert_record(factor, [X, E, clock], lambda k, X, E, c: twin.lidar_pose(X, E, c, Z.matrix[k], omega[k], span[k]))


def test_lidar_pose_of_the_truth_has_no_residual(rng):
    """A body that turns and moves steadily, seen by a LiDAR whose stamps are late and drift."""
    omega, E = np.array([0.3, -0.8, 0.5]), se3.exp([0.1, 0.2, -0.3, 0.4, 0.1, -0.2])
    span, keys = np.array([-10.0, 3.0, 12.0]), np.arange(3)
    later = 0.004 + 30e-6 * span
    R = so3.exp(rng.normal(size=(3, 3)))
    p, v = rng.normal(size=(2, 3, 3))
    X = ExtendedPose(se23.from_rotation_position_velocity(R, p, v))
    seen = se3.from_rotation_translation(R @ so3.exp(later[:, None] * omega), p + later[:, None] * v) @ E
    factor = LidarPose(keys, 10, 11, SE3(seen), omega, span, ONE)
    np.testing.assert_allclose(factor.evaluate(X, SE3(E), [0.004, 30e-6])[0], 0.0, atol=1e-12)
    wrong = factor.evaluate(X, SE3(E), np.zeros(2))[0]
    np.testing.assert_allclose(np.linalg.norm(wrong[:, :3], axis=1), np.abs(later) * np.linalg.norm(omega), rtol=1e-9)


def test_calibration_prior_is_its_twin(rng):
    keys, E_0, clock_0 = np.arange(COUNT), SE3.exp(0.3 * rng.normal(size=(COUNT, 6))), rng.normal(size=(COUNT, 2))
    factor = CalibrationPrior(keys, 10 + keys, E_0, clock_0, ONE)
    E, clock = E_0.retract(rng.normal(size=(COUNT, 6))), rng.normal(size=(COUNT, 2))
    assert_record(factor, [E, clock], lambda k, E, c: twin.calibration_prior(E, c, E_0.matrix[k], clock_0[k]))


def test_calibration_prior_counts_turns_about_the_imus_axes():
    E_0 = se3.exp([0.0, 0.0, np.pi / 2, 1.0, 2.0, 3.0])
    E = E_0.copy()
    E[:3, :3] = so3.exp([0.1, 0.0, 0.0]) @ E_0[:3, :3]
    E[:3, 3] += [0.0, 0.2, 0.0]
    found = CalibrationPrior(0, 1, SE3(E_0), [1.0, 2.0], ONE).evaluate(SE3(E), [1.5, 2.0])[0]
    np.testing.assert_allclose(found, [[0.1, 0.0, 0.0, 0.0, 0.2, 0.0, 0.5, 0.0]], atol=1e-12)


def test_values_that_do_not_fit_are_refused(rng):
    factor = Velocity(np.arange(COUNT), np.zeros(3), ONE)
    with pytest.raises(GraphError, match="joins 1 variables, got values of 2"):
        factor.evaluate(poses(rng), poses(rng))
    with pytest.raises(GraphError, match="needs ExtendedPose, but its variables are SE3"):
        factor.evaluate(poses(rng, False))
    with pytest.raises(GraphError, match="3 factors"):
        factor.evaluate(poses(rng)[:2])
    with pytest.raises(GraphError, match="body rates have 3 numbers"):
        LidarPose(0, 1, 2, SE3.identity(), np.zeros(2), 0.0, ONE)
    with pytest.raises(GraphError, match="a pose is an SE3"):
        LidarPose(0, 1, 2, np.zeros(3), np.zeros(3), 0.0, ONE)
    with pytest.raises(GraphError, match="a clock has 2 numbers"):
        CalibrationPrior(0, 1, SE3.identity(), np.zeros(3), ONE)
    with pytest.raises(GraphError, match="a mounting is an SE3"):
        CalibrationPrior(0, 1, np.zeros(3), np.zeros(2), ONE)


def digest():
    """All sensors' numbers in one vector, for the comparison of two instruction sets."""
    rng, parts = np.random.default_rng(5), []
    motion, keys = motions(rng), np.arange(COUNT)
    X_i, X_j, bias = poses(rng), poses(rng), np.hstack([motion.gyro_bias, motion.accel_bias])
    for kind in ("known", "direction", "vector"):
        given, variables, _ = gravity_of(kind, rng)
        near_bias = bias + 1e-5 * rng.normal(size=(COUNT, 6))
        plain = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=given)
        parts.append(plain.evaluate(X_i, X_j, near_bias, *variables))
        walking = CombinedImu(keys, 10 + keys, 20 + keys, 30 + keys, motion, gravity=given)
        parts.append(walking.evaluate(X_i, near_bias, X_j, bias, *variables))
    z = rng.normal(size=(COUNT, 3))
    parts.append(LeverArmPosition(keys, z, ONE, arm_key=10 + keys).evaluate(X_i, rng.normal(size=(COUNT, 3))))
    parts.append(Velocity(keys, z, ONE).evaluate(X_i))
    parts.append(AnchoredPosition(keys, 10 + keys, z, ONE).evaluate(X_i, poses(rng, False)))
    parts.append(MeanForce(keys, 10 + keys, 20 + keys, z, np.eye(3), ONE).evaluate(X_i, z, 2.0 * z))
    parts.append(ScaledMotion(keys, 10 + keys, 20 + keys, z, ONE).evaluate(X_i, X_j, np.ones((COUNT, 1))))
    E, clock = SE3.exp(0.5 * rng.normal(size=(COUNT, 6))), rng.normal(size=(COUNT, 2))
    sweep = LidarPose(keys, 10 + keys, 20 + keys, poses(rng, False), z, np.ones(COUNT), ONE)
    parts.append(sweep.evaluate(X_i, E, clock))
    parts.append(CalibrationPrior(keys, 10 + keys, SE3.identity(), np.zeros(2), ONE).evaluate(E, clock))
    return [array for residual, jacobians in parts for array in (residual, *jacobians)]


def test_both_instruction_sets_give_the_same_numbers(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from test_sensor_factors import digest\n"
        "np.save(sys.argv[1], np.concatenate([part.ravel() for part in digest()]))"
    )
    environment = {**os.environ, "HELIOGRAPH_ISA": "baseline", "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.npy")], env=environment, check=True)
    other, at = np.load(tmp_path / "a.npy"), 0
    for numbers in digest():
        bound = 1e-11 * max(1.0, np.abs(numbers).max())
        np.testing.assert_allclose(other[at : at + numbers.size], numbers.ravel(), rtol=0, atol=bound)
        at += numbers.size
    assert at == other.size
