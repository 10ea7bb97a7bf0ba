"""Inertial propagation against its twin, its own numeric derivative at large errors, and drawn noise."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu import propagate
from heliograph.lie import s2, so3
from heliograph.odometry.filter.error_state import local, retract
from heliograph.testing import assert_jacobian
from reference.propagation import propagate_slowly
from states import GRAVITY, NOISE, START_NS, random_imu, random_state, rest_state

CONFIG = ImuConfig()
END_NS = START_NS + 250_000_000


def g_basis(state):
    return GRAVITY * s2.basis(state.g_odom / GRAVITY)


def constant_imu(gyro, accel, *, rate=100.0, duration=1.0):
    stamps = START_NS + np.arange(0, int(duration * 1e9) + 1, int(1e9 / rate), dtype=np.int64)
    ones = np.ones((len(stamps), 1))
    return ImuBatch(stamps_ns=stamps, gyro=ones * gyro, accel=ones * accel, received_ns=int(stamps[-1]))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rate", [10.0, 100.0, 400.0])
def test_propagation_equals_its_twin(seed, rate):
    rng = np.random.default_rng(seed)
    imu, state = random_imu(rng, rate=rate, before=1.5 / rate), random_state(rng)
    moved, path = propagate(state, imu, END_NS, noise=NOISE, config=CONFIG)
    stamps, R, p, v, F, Q, held_s = propagate_slowly(
        imu, state, END_NS, noise=NOISE, config=CONFIG, g_basis=g_basis(state)
    )
    np.testing.assert_array_equal(path.stamps_ns, stamps)
    np.testing.assert_allclose(path.R_odom_imu, R, atol=1e-12)
    np.testing.assert_allclose(path.p_odom, p, rtol=1e-12)
    np.testing.assert_allclose(path.v_odom, v, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(moved.covariance, F @ state.covariance @ F.T + Q, rtol=1e-8, atol=1e-12)
    assert path.held_s == pytest.approx(held_s, abs=1e-12)


@pytest.mark.parametrize(
    ("cut", "held_s"), [(slice(0, 8), 0.1799), (slice(12, None), 0.0999), ([0, 1, 2, 28, 29, 30, 31], 0.25)]
)
def test_propagation_outside_the_samples_holds_them_and_says_so(rng, cut, held_s):
    whole = random_imu(rng, jitter=0.0, duration=0.5)
    imu = replace(whole, stamps_ns=whole.stamps_ns[cut], gyro=whole.gyro[cut], accel=whole.accel[cut])
    state = random_state(rng)
    moved, path = propagate(state, imu, END_NS, noise=NOISE, config=CONFIG)
    _, _, p, _, F, Q, slow_held_s = propagate_slowly(
        imu, state, END_NS, noise=NOISE, config=CONFIG, g_basis=g_basis(state)
    )
    np.testing.assert_allclose(path.p_odom[-1], p[-1], rtol=1e-12)
    np.testing.assert_allclose(moved.covariance, F @ state.covariance @ F.T + Q, rtol=1e-8, atol=1e-12)
    assert path.held_s == pytest.approx(slow_held_s, abs=1e-12)
    assert path.held_s == pytest.approx(held_s, abs=0.011)


@pytest.mark.parametrize("seed", range(3))
def test_transition_is_the_derivative_of_the_propagation_at_large_errors(seed):
    rng = np.random.default_rng(100 + seed)
    imu, state = random_imu(rng, rate=50.0), random_state(rng)
    # A unit covariance without noise comes out as F F^T; columns of F come out of rank-one ones.
    still = replace(NOISE, gyro=0.0, accel=0.0, gyro_walk=0.0, accel_walk=0.0)
    config = replace(CONFIG, curvature=0.0, held_gyro_noise=0.0, held_accel_noise=0.0)
    origin, _ = propagate(state, imu, END_NS, noise=still, config=config)

    def moved(delta):
        return local(origin, propagate(retract(state, delta), imu, END_NS, noise=still, config=config)[0])

    slow = propagate_slowly(imu, state, END_NS, noise=still, config=config, g_basis=g_basis(state))[4]
    assert_jacobian(moved, np.zeros(17), slow, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(origin.covariance, slow @ state.covariance @ slow.T, rtol=1e-8, atol=1e-12)


def test_propagation_leaves_the_mounting_alone_but_keeps_its_correlation(rng):
    state = random_state(rng, dim=23)
    moved, _ = propagate(state, random_imu(rng), END_NS, noise=NOISE, config=CONFIG)
    F = propagate_slowly(random_imu(np.random.default_rng(20260101)), state, END_NS, noise=NOISE, config=CONFIG,
                         g_basis=g_basis(state))[4]  # fmt: skip
    assert F.shape == (17, 17)
    np.testing.assert_array_equal(moved.covariance[17:, 17:], state.covariance[17:, 17:])
    assert np.abs(moved.covariance[:17, 17:]).max() > 0.0
    np.testing.assert_array_equal(moved.T_imu_lidar, state.T_imu_lidar)


def test_noise_matches_drawn_noise():
    """The covariance added on the way is the spread of propagations whose samples were disturbed as the model says."""
    rate, draws, rng = 100.0, 1500, np.random.default_rng(8)
    imu = random_imu(rng, rate=rate, jitter=0.0, before=0.01)
    config = replace(CONFIG, curvature=0.0, max_step=0.01)
    state = replace(random_state(rng), covariance=np.zeros((17, 17)))
    noise = replace(NOISE, gyro_walk=0.02, accel_walk=0.2)
    truth, _ = propagate(state, imu, END_NS, noise=noise, config=config)
    errors = np.zeros((draws, 17))
    root, shape = np.sqrt(rate), imu.gyro.shape
    inside = ((imu.stamps_ns > START_NS) & (imu.stamps_ns <= END_NS))[:, None]
    for k in range(draws):
        walks = [
            np.cumsum(inside * w / root * rng.normal(size=shape), axis=0) for w in (noise.gyro_walk, noise.accel_walk)
        ]
        gyro = imu.gyro + walks[0] + noise.gyro * root * rng.normal(size=shape)
        accel = imu.accel + walks[1] + noise.accel * root * rng.normal(size=shape)
        guess, _ = propagate(state, replace(imu, gyro=gyro, accel=accel), END_NS, noise=noise, config=config)
        last = np.flatnonzero(inside)[-1]
        drifted = replace(
            truth, gyro_bias=truth.gyro_bias + walks[0][last], accel_bias=truth.accel_bias + walks[1][last]
        )
        errors[k] = local(guess, drifted)
    P = truth.covariance[:15, :15]
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    # Ends of the interval see half a sample's noise, so a few per cent remain beside the draw's own scatter.
    np.testing.assert_allclose(np.cov(errors[:, :15].T) / scale, P / scale, atol=0.17)
    np.testing.assert_allclose(np.var(errors[:, :15], axis=0) / np.diag(P), 1.0, atol=0.17)


def test_rest_stays_at_rest():
    moved, _ = propagate(
        rest_state(), constant_imu([0, 0, 0], [0, 0, GRAVITY]), START_NS + 10**9, noise=NOISE, config=CONFIG
    )
    np.testing.assert_allclose(moved.p_odom, 0.0, atol=1e-12)
    np.testing.assert_allclose(moved.v_odom, 0.0, atol=1e-12)


def test_turn_while_accelerating_follows_the_circle():
    """A body on a circle of radius v / w feels v w inwards: after half a turn it is across the circle."""
    w, v = np.pi, 2.0
    imu = constant_imu([0, 0, w], [0, v * w, GRAVITY], rate=1000.0)
    start = replace(rest_state(), v_odom=np.array([v, 0.0, 0.0]))
    moved, _ = propagate(start, imu, START_NS + 10**9, noise=NOISE, config=replace(CONFIG, max_step=1e-3))
    np.testing.assert_allclose(moved.p_odom, [0.0, 2.0 * v / w, 0.0], atol=1e-5)
    np.testing.assert_allclose(moved.R_odom_imu, so3.exp(np.array([0.0, 0.0, w])), atol=1e-9)


def test_dead_reckoning_uncertainty_grows_as_the_cube_and_the_square_of_time():
    imu = constant_imu([0, 0, 0], [0, 0, GRAVITY], duration=8.0)
    noise = replace(NOISE, gyro=0.0, gyro_walk=0.0, accel_walk=0.0)
    sigma = [
        np.sqrt(propagate(rest_state(), imu, START_NS + t * 10**9, noise=noise, config=CONFIG)[0].covariance[3, 3])
        for t in (2, 8)
    ]
    assert sigma[1] / sigma[0] == pytest.approx(4.0**1.5, rel=1e-6)
    assert sigma[1] == pytest.approx(noise.accel * np.sqrt(8.0**3 / 3.0), rel=1e-3)


def test_slow_imu_is_trusted_less(rng):
    fast, slow = random_imu(rng, rate=200.0, jitter=0.0), random_imu(rng, rate=10.0, jitter=0.0, before=0.1)
    sigma = [
        propagate(rest_state(), imu, END_NS, noise=NOISE, config=CONFIG)[0].covariance[5, 5] for imu in (fast, slow)
    ]
    assert sigma[1] > 4.0 * sigma[0]


def test_zero_interval_changes_nothing(rng):
    state = random_state(rng)
    moved, path = propagate(state, random_imu(rng), state.stamp_ns, noise=NOISE, config=CONFIG)
    np.testing.assert_allclose(moved.covariance, state.covariance, rtol=1e-14)
    assert len(path.stamps_ns) == 1
    assert path.held_s == 0.0


def test_single_sample_is_held_for_a_while_then_the_body_coasts(rng):
    imu = constant_imu([0.1, 0.2, 0.3], [0, 0, GRAVITY], duration=0.0)
    moved, path = propagate(rest_state(), imu, END_NS, noise=NOISE, config=CONFIG)
    np.testing.assert_allclose(so3.log(moved.R_odom_imu), CONFIG.hold * np.array([0.1, 0.2, 0.3]), atol=1e-12)
    assert path.held_s == pytest.approx(0.25)


def test_propagation_refuses_what_it_cannot_do(rng):
    state, imu = random_state(rng), random_imu(rng)
    with pytest.raises(DataError, match=r"backwards by 0\.100 s"):
        propagate(state, imu, state.stamp_ns - 10**8, noise=NOISE, config=CONFIG)
    empty = replace(imu, stamps_ns=imu.stamps_ns[:0], gyro=imu.gyro[:0], accel=imu.accel[:0])
    with pytest.raises(DataError, match="no IMU sample"):
        propagate(state, empty, END_NS, noise=NOISE, config=CONFIG)


def test_coasting_keeps_velocity_and_heading_whatever_else_is_uncertain(rng):
    """No sample for a second: neither a bias nor a tilt may reach the velocity, only the noise of not knowing."""
    state = random_state(rng)
    imu = constant_imu([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], duration=0.0)
    late = START_NS + 10**9
    begun, _ = propagate(state, imu, late, noise=NOISE, config=CONFIG)
    moved, _ = propagate(begun, imu, late + 10**9, noise=NOISE, config=CONFIG)
    np.testing.assert_allclose(moved.R_odom_imu, begun.R_odom_imu, atol=1e-14)
    np.testing.assert_allclose(moved.v_odom, begun.v_odom, atol=1e-12)
    np.testing.assert_allclose(moved.p_odom, begun.p_odom + begun.v_odom, atol=1e-9)
    grown = moved.covariance[6:9, 6:9] - begun.covariance[6:9, 6:9]
    np.testing.assert_allclose(grown, (CONFIG.held_accel_noise**2 + NOISE.accel**2) * np.eye(3), rtol=1e-9, atol=1e-12)
