"""Preintegration against direct propagation, its own numeric derivative, and drawn noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu import preintegrate, propagate
from heliograph.lie import ExtendedPose, se23
from heliograph.testing import numeric_jacobian
from reference.preintegration import integrate_readings
from states import GRAVITY, NOISE, START_NS, random_imu, random_state

CONFIG = ImuConfig()
END_NS = START_NS + 250_000_000
CUTS = [slice(None), slice(0, 8), slice(12, None), [0, 1, 2, 28, 29, 30, 31], [30], [0, 31]]


def of_state(state):
    return ExtendedPose.from_rotation_position_velocity(state.R_odom_imu, state.p_odom, state.v_odom)


def some_of(imu, cut):
    return replace(imu, stamps_ns=imu.stamps_ns[cut], gyro=imu.gyro[cut], accel=imu.accel[cut])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rate", [10.0, 100.0, 400.0])
def test_prediction_equals_propagation(seed, rate):
    rng = np.random.default_rng(seed)
    imu, state = random_imu(rng, rate=rate, before=1.5 / rate), random_state(rng)
    moved, path = propagate(state, imu, END_NS, noise=NOISE, config=CONFIG)
    motion = preintegrate(imu, START_NS, END_NS, noise=NOISE, gyro_bias=state.gyro_bias, accel_bias=state.accel_bias)
    found = motion.predict(of_state(state), state.gyro_bias, state.accel_bias, state.g_odom)
    np.testing.assert_allclose(found.matrix[0], of_state(moved).matrix, rtol=0, atol=1e-9)
    assert motion.held_s[0] == pytest.approx(path.held_s, abs=1e-12)


@pytest.mark.parametrize("cut", CUTS)
def test_prediction_equals_propagation_where_samples_lack(rng, cut):
    imu = some_of(random_imu(rng, jitter=0.0, duration=0.5), cut)
    state, end = random_state(rng), START_NS + 700_000_000
    moved, path = propagate(state, imu, end, noise=NOISE, config=CONFIG)
    motion = preintegrate(imu, START_NS, end, noise=NOISE, gyro_bias=state.gyro_bias, accel_bias=state.accel_bias)
    found = motion.predict(of_state(state), state.gyro_bias, state.accel_bias, state.g_odom)
    np.testing.assert_allclose(found.matrix[0], of_state(moved).matrix, rtol=0, atol=1e-9)
    assert motion.held_s[0] == pytest.approx(path.held_s, abs=1e-12)


def to_tangent(state):
    """From errors of the filter, position and velocity in odom, to a right perturbation of the extended pose."""
    J = np.eye(15)
    J[3:6, 3:6] = J[6:9, 6:9] = state.R_odom_imu.T
    return J


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_covariances_equal_those_of_propagation(rng, cut, rate):
    imu = random_imu(rng, rate=rate, duration=0.5)
    imu = some_of(imu, cut if rate > 50.0 else slice(None))
    end = START_NS + 600_000_000
    state = replace(random_state(rng), covariance=np.zeros((17, 17)))
    biases = {"gyro_bias": state.gyro_bias, "accel_bias": state.accel_bias}
    motion = preintegrate(imu, START_NS, end, noise=NOISE, **biases)
    for walking, found in ((False, motion.covariance[0]), (True, motion.combined[0])):
        noise = NOISE if walking else replace(NOISE, gyro_walk=0.0, accel_walk=0.0)
        moved, _ = propagate(state, imu, end, noise=noise, config=CONFIG)
        J = to_tangent(moved)
        expected = (J @ moved.covariance[:15, :15] @ J.T)[: len(found), : len(found)]
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("cut", CUTS)
def test_bias_jacobian_is_the_derivative_of_the_scheme(rng, cut):
    imu, end = some_of(random_imu(rng, duration=0.5), cut), START_NS + 600_000_000
    bias = rng.normal(scale=0.3, size=6)

    def moved(change):
        b = bias + change
        other = preintegrate(imu, START_NS, end, noise=NOISE, gyro_bias=b[:3], accel_bias=b[3:])
        return se23.local(motion.delta.matrix[0], other.delta.matrix[0])

    motion = preintegrate(imu, START_NS, end, noise=NOISE, gyro_bias=bias[:3], accel_bias=bias[3:])
    np.testing.assert_allclose(motion.bias_jacobian[0], numeric_jacobian(moved, np.zeros(6)), rtol=0, atol=1e-9)


def test_error_of_the_correction_is_second_order(rng):
    imu, end = random_imu(rng, duration=1.1, rate=200.0), START_NS + 1_000_000_000
    direction = rng.normal(size=6)
    motion = preintegrate(imu, START_NS, end, noise=NOISE)
    errors = []
    for size in (0.02, 0.01, 0.005):
        b = size * direction
        biases = {"gyro_bias": b[:3], "accel_bias": b[3:]}
        exact = preintegrate(imu, START_NS, end, noise=NOISE, **biases)
        error = motion.corrected(**biases).delta.local(exact.delta)[0]
        errors.append(np.linalg.norm(error.reshape(3, 3), axis=1))
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    np.testing.assert_allclose(ratios, 4.0, rtol=0.1)


def test_accelerometer_bias_is_corrected_exactly(rng):
    imu, end = random_imu(rng, duration=1.1), START_NS + 1_000_000_000
    bias = rng.normal(size=3)
    found = preintegrate(imu, START_NS, end, noise=NOISE).corrected(np.zeros(3), bias)
    exact = preintegrate(imu, START_NS, end, noise=NOISE, accel_bias=bias)
    np.testing.assert_allclose(found.delta.matrix, exact.delta.matrix, rtol=0, atol=1e-11)


def test_batch_equals_its_intervals_one_by_one(rng):
    imu = random_imu(rng, duration=2.0)
    starts = START_NS + rng.integers(-100_000_000, 1_500_000_000, 9)
    ends = starts + rng.integers(0, 600_000_000, 9)
    bias = rng.normal(scale=0.1, size=(9, 3))
    batch = preintegrate(imu, starts, ends, noise=NOISE, gyro_bias=bias)
    for k in range(9):
        one = preintegrate(imu, int(starts[k]), int(ends[k]), noise=NOISE, gyro_bias=bias[k])
        for name in ("delta_R", "delta_p", "delta_v", "covariance", "combined", "bias_jacobian", "held_s"):
            np.testing.assert_array_equal(getattr(batch[k : k + 1], name), getattr(one, name))


def test_an_empty_interval_is_no_motion(rng):
    motion = preintegrate(random_imu(rng), START_NS, START_NS, noise=NOISE)
    np.testing.assert_array_equal(motion.delta.matrix[0], np.eye(5))
    assert not motion.combined.any()
    assert not motion.bias_jacobian.any()


def drawn(rng, draws, count, noise):
    """Return errors (draws, 15) of one motion whose readings carry drawn noise, one step a sample, and the motion."""
    period = 5_000_000
    dt, stamps = 1e-9 * period, START_NS + period * np.arange(count + 1, dtype=np.int64)
    t = 1e-9 * (stamps - START_NS)[:, None]
    gyro = np.array([0.8, -0.5, 1.2]) * np.sin(np.array([2.0, 3.0, 1.0]) * t)
    accel = np.array([1.0, 0.5, GRAVITY]) + np.array([2.0, 3.0, 1.0]) * np.cos(np.array([5.0, 2.0, 3.0]) * t)
    truth = ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=0)
    motion = preintegrate(truth, START_NS, int(stamps[-1]), noise=noise, config=ImuConfig(curvature=0.0))
    white_gyro, white_accel, walk_gyro, walk_accel = rng.normal(size=(4, draws, count, 3))
    walk_gyro = noise.gyro_walk * np.sqrt(dt) * np.cumsum(walk_gyro, axis=1)
    walk_accel = noise.accel_walk * np.sqrt(dt) * np.cumsum(walk_accel, axis=1)
    middle_gyro, middle_accel = 0.5 * (gyro[1:] + gyro[:-1]), 0.5 * (accel[1:] + accel[:-1])
    # The true motion is what is left when noise and the bias before the step are taken off.
    before = [np.concatenate([np.zeros((draws, 1, 3)), walk[:, :-1]], axis=1) for walk in (walk_gyro, walk_accel)]
    delta = integrate_readings(
        middle_gyro - noise.gyro / np.sqrt(dt) * white_gyro - before[0],
        middle_accel - noise.accel / np.sqrt(dt) * white_accel - before[1],
        dt,
    )
    moved = se23.local(np.broadcast_to(motion.delta.matrix, delta.shape), delta)
    return np.concatenate([moved, walk_gyro[:, -1], walk_accel[:, -1]], axis=1), motion


@pytest.mark.parametrize("walking", [False, True])
def test_covariance_is_that_of_drawn_noise(rng, walking):
    draws = 2000
    walk = {"gyro_walk": 2e-3, "accel_walk": 3e-2} if walking else {"gyro_walk": 0.0, "accel_walk": 0.0}
    noise = replace(NOISE, **walk)
    errors, motion = drawn(rng, draws, 100, noise)
    P = motion.combined[0] if walking else motion.covariance[0]
    errors = errors[:, : len(P)]
    squared = np.einsum("ni,ni->n", errors @ np.linalg.inv(P), errors)
    low, high = chi2.ppf([0.005, 0.995], draws * len(P))
    assert low < squared.sum() < high
    # Each direction by itself: a covariance may be right in the sum and wrong in every part.
    whitened = np.linalg.solve(np.linalg.cholesky(P), errors.T)
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], draws)
    powers = (whitened**2).sum(axis=1)
    assert ((powers > low) & (powers < high)).all()
    mixed = whitened @ whitened.T / draws - np.diag(powers / draws)
    assert np.abs(mixed).max() < 4.5 / np.sqrt(draws)


def test_wrong_intervals_and_biases_are_refused(rng):
    imu = random_imu(rng)
    for start, end, bias, message in (
        (END_NS, START_NS, np.zeros(3), "before it starts"),
        (float(START_NS), END_NS, np.zeros(3), "integer"),
        ([START_NS], [END_NS, END_NS], np.zeros(3), "as many"),
        (START_NS, END_NS, np.zeros((2, 3)), "a bias is"),
        (START_NS, END_NS, np.full(3, np.nan), "a bias is"),
    ):
        with pytest.raises(DataError, match=message):
            preintegrate(imu, start, end, noise=NOISE, gyro_bias=bias)
    with pytest.raises(DataError, match="no IMU sample"):
        preintegrate(some_of(imu, slice(0, 0)), START_NS, END_NS, noise=NOISE)
