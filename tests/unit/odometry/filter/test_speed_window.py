"""The mean speed of wheels before a scan's end: what a state says of it, and its Jacobian at large errors."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data.error_layout import ACCEL_BIAS, GRAVITY, GYRO_BIAS, VELOCITY
from heliograph.imu import predict
from heliograph.odometry.filter.error_state import retract
from heliograph.odometry.filter.speed_window import SpeedWindow
from heliograph.testing import assert_jacobian
from states import NOISE, START_NS, random_imu, random_rotation, random_state

ARM = np.array([0.6, -0.3, -0.4])
END_NS = START_NS + 100_000_000


def true_window(rng, state, R_imu_vehicle, *, arm=ARM):
    """The window of noiseless speeds of the motion that a state and samples make, and the prediction."""
    ahead = predict(state, random_imu(rng, duration=0.2, rate=400.0), END_NS, noise=NOISE, config=ImuConfig())
    path = ahead.path
    seconds = 1e-9 * (path.stamps_ns - path.stamps_ns[0])
    point = path.p_odom + path.R_odom_imu @ arm
    v = np.einsum("nji,nj->ni", path.R_odom_imu, np.gradient(point, seconds, axis=0))
    stamps = path.stamps_ns.copy()
    stamps[0] -= 1  # the speeds reach from before the window to after it
    stamps[-1] += 1
    return SpeedWindow.of(stamps, v / state.wheel_scale, path, ahead.state, R_imu_vehicle, arm), ahead.state


@pytest.mark.parametrize("seed", range(4))
def test_true_speeds_leave_no_residual(seed):
    rng = np.random.default_rng(seed)
    state = replace(random_state(rng, dim=26), wheel_scale=1.07)
    window, end = true_window(rng, state, random_rotation(rng))
    assert window.seconds == pytest.approx(0.1, abs=1e-6)
    np.testing.assert_allclose(window.residual(end), 0.0, atol=0.02)  # of differences over samples 2.5 ms apart


@pytest.mark.parametrize("seed", range(6))
def test_jacobian_is_the_derivative_at_large_errors(seed):
    rng = np.random.default_rng(seed)
    window, end = true_window(rng, random_state(rng, dim=26), random_rotation(rng))
    delta = rng.normal(scale=1.0, size=26)
    delta[GRAVITY] *= 0.3
    far = retract(end, delta)
    assert np.linalg.norm(window.residual(far)) > 0.3  # or the test would not be about large errors
    assert_jacobian(
        lambda e: window.residual(retract(far, e)), np.zeros(26), window.jacobian(far), rtol=1e-6, atol=1e-7
    )


def test_a_state_predicted_with_other_errors_is_foreseen_to_first_order():
    """What the window says of velocity, biases and gravity at its end is what integrating them anew says."""
    rng = np.random.default_rng(3)
    state = replace(random_state(rng, dim=26), wheel_scale=1.0)
    imu = random_imu(deepcopy(rng), duration=0.2, rate=400.0)
    window, _ = true_window(rng, state, np.eye(3))
    # A rate's error also turns the force within the window, which is left out: it changes a speed by a twelfth.
    for part, size, of in (
        (VELOCITY, 0.1, 0.02), (GYRO_BIAS, 0.01, 0.15), (ACCEL_BIAS, 0.3, 0.02), (GRAVITY, 0.02, 0.05),
    ):  # fmt: skip
        delta = np.zeros(26)
        delta[part] = size
        ends = [predict(one, imu, END_NS, noise=NOISE, config=ImuConfig()) for one in (state, retract(state, delta))]
        points = [one.path.p_odom + one.path.R_odom_imu @ ARM for one in ends]
        means = [
            one.state.R_odom_imu.T @ (point[-1] - point[0]) / window.seconds
            for one, point in zip(ends, points, strict=True)
        ]
        changed = window.foreseen(ends[1].state) - window.foreseen(ends[0].state)
        np.testing.assert_allclose(changed, means[1] - means[0], atol=of * size)


def test_speeds_that_do_not_cover_the_sweep_say_nothing(rng):
    state = random_state(rng, dim=26)
    ahead = predict(state, random_imu(rng, duration=0.2, rate=400.0), END_NS, noise=NOISE, config=ImuConfig())
    some = np.arange(START_NS - 10**9, END_NS + 10**9, 20_000_000)
    v = np.zeros((len(some), 3))
    assert SpeedWindow.of(some, v, ahead.path, ahead.state, np.eye(3), ARM) is not None
    for kept in (some < END_NS, some > START_NS, (some < START_NS - 3 * 10**8) | (some > END_NS), some < 0):
        assert SpeedWindow.of(some[kept], v[kept], ahead.path, ahead.state, np.eye(3), ARM) is None
