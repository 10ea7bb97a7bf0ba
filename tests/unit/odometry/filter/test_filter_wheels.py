"""Speeds of wheels in the filter: believed once earned, gated, of the scale they have, and as uncertain as they say."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import ImuConfig, WheelConfig
from heliograph.data import ImuBatch, WheelSpeeds
from heliograph.data.error_layout import ACCEL_BIAS, GRAVITY, POSITION, VELOCITY, WHEEL_SCALE
from heliograph.imu import predict
from heliograph.lie import so3
from heliograph.odometry.filter.error_state import retract
from heliograph.odometry.filter.wheels import SpeedUpdates, with_wheel_scale
from states import GRAVITY as G
from states import NOISE, START_NS, rest_state

RATE, STEP_NS, SPEED = 100, 100_000_000, 2.0
PRIOR = np.repeat([2e-3, 1e-3, 0.02, 1e-4, 0.01], 3)


def speeds(rng, seconds, *, scale=1.0, factor=1.0, noise=0.05, speed=SPEED):
    """Speeds whose error lasts a sweep, of a straight way."""
    stamps = START_NS - 10**8 + np.arange(0, round(1e9 * seconds) + 3 * 10**8, 2 * 10**7)
    v = np.full((len(stamps), 3), np.nan)
    error = np.repeat(noise * rng.normal(size=len(stamps) // 5 + 1), 5)[: len(stamps)]
    v[:, 0] = factor * speed / scale + error
    return WheelSpeeds(stamps_ns=stamps, v_body=v, received_ns=int(stamps[-1]))


def begin(rng, config, speed=SPEED):
    """A start with drawn errors, and the truth."""
    truth = replace(with_wheel_scale(rest_state(), config), v_odom=np.array([speed, 0.0, 0.0]))
    P = np.zeros((26, 26))
    P[:15, :15] = np.diag(PRIOR**2)
    P[GRAVITY, GRAVITY] = 1e-3**2 * np.eye(2)
    P[WHEEL_SCALE, WHEEL_SCALE] = config.scale_sigma**2
    error = rng.normal(size=26) * np.sqrt(np.diag(P))
    error[WHEEL_SCALE] = 0.0
    return truth, replace(retract(truth, error), covariance=P)


def drive(rng, wheels, *, seconds=8.0, seen=3.0, config=None, begun=None, updates=None, imu_noise=NOISE):
    """Predictions from scan to scan; until ``seen`` a LiDAR tells the velocity too, afterwards nothing does."""
    config = config or WheelConfig()
    truth, state = begun or begin(rng, config)
    updates = SpeedUpdates(config) if updates is None else updates
    if wheels is not None:
        updates.observe(wheels)
    v = truth.v_odom
    for k in range(round(seconds * 1e9) // STEP_NS):
        begin_ns, end_ns = START_NS + k * STEP_NS, START_NS + (k + 1) * STEP_NS
        stamps = np.arange(begin_ns, end_ns + 1, 10**9 // RATE)
        root = np.sqrt(RATE)
        imu = ImuBatch(
            stamps_ns=stamps, received_ns=end_ns,
            gyro=imu_noise.gyro * root * rng.normal(size=(len(stamps), 3)),
            accel=np.array([0.0, 0.0, G]) + imu_noise.accel * root * rng.normal(size=(len(stamps), 3)),
        )  # fmt: skip
        ahead = predict(state, imu, end_ns, noise=imu_noise, config=ImuConfig())
        told = updates.updated(ahead.state, ahead.path, None, sees=k * STEP_NS < seen * 1e9)
        state = ahead.state if told is None else told.state
        if k * STEP_NS < seen * 1e9:
            state = lidar(rng, state, v, np.array([1e-9 * (end_ns - START_NS) * v[0], 0.0, 0.0]))
    return updates, state


def lidar(rng, state, v, p):
    """A scan tells position and attitude as well as the velocity."""
    H = np.zeros((9, 26))
    H[:, :9] = np.eye(9)
    sigma = np.repeat([1e-3, 0.01, 0.02], 3)
    error = np.r_[np.zeros(3), p - state.p_odom, v - state.v_odom]
    error[:3] = so3.log(state.R_odom_imu.T)
    error += sigma * rng.normal(size=9)
    P = state.covariance
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(sigma**2))
    return replace(retract(state, gain @ error), covariance=(np.eye(26) - gain @ H) @ P)


def test_scale_is_found_where_the_lidar_sees_and_carries_the_way_after_it(rng):
    updates, state = drive(rng, speeds(rng, 10.0, scale=1.03), seconds=10.0, seen=6.0)
    assert updates.trust.believed
    assert updates.trust.slips <= 2
    sigma = np.sqrt(state.covariance[WHEEL_SCALE, WHEEL_SCALE])
    assert abs(state.wheel_scale - 1.03) < 3.5 * sigma < 0.03
    _, alone = drive(np.random.default_rng(1), None, seconds=10.0, seen=6.0)
    along = POSITION.start
    assert state.covariance[along, along] < 0.6 * alone.covariance[along, along]
    assert abs(state.p_odom[0] - 10.0 * SPEED) < 3.5 * np.sqrt(state.covariance[along, along])


def test_errors_are_as_large_as_their_covariance_says():
    nees = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        _, state = drive(rng, speeds(rng, 4.0), seconds=4.0, seen=2.0, config=WheelConfig(scale_sigma=0.01))
        off = np.r_[state.v_odom[0] - SPEED, state.p_odom[0] - 4.0 * SPEED, state.wheel_scale - 1.0]
        kept = [VELOCITY.start, POSITION.start, WHEEL_SCALE]
        nees.append(off @ np.linalg.solve(state.covariance[np.ix_(kept, kept)], off))
    assert 1.2 < np.mean(nees) < 5.5  # 3 degrees of freedom, 12 runs: 1.3 to 5.5 by chance in 999 of 1000


@pytest.mark.parametrize(("factor", "ratio"), [(-1.0, "-1.0"), (3.6, "0.2"), (0.0, "0.0")])
def test_wheels_of_a_wrong_sign_or_unit_or_stuck_never_count(rng, factor, ratio):
    updates, state = drive(rng, speeds(rng, 8.0, factor=factor, noise=0.01))
    assert updates.trust.used == 0
    assert state.wheel_scale == 1.0
    np.testing.assert_array_equal(
        state.covariance[WHEEL_SCALE], WheelConfig().scale_sigma ** 2 * np.eye(26)[WHEEL_SCALE]
    )
    (event,) = updates.conclusion(state)
    assert event.code == "wheel-contradiction"
    assert f"is {ratio}" in event.message or factor == 0.0  # the way by the digits that do not hang on noise


def test_slip_is_left_out_and_told_once_a_spell(rng):
    wheels = speeds(rng, 14.0)
    v = wheels.v_body.copy()
    for first in (5, 9):
        slipping = (wheels.stamps_ns > START_NS + first * 10**9) & (wheels.stamps_ns < START_NS + (first + 1) * 10**9)
        v[slipping, 0] *= 1.3
    updates, state = drive(rng, replace(wheels, v_body=v), seconds=14.0)
    assert [event.code for event in updates.taken_events()] == ["wheel-slip", "wheel-slip"]
    assert 16 <= updates.trust.slips <= 26
    assert abs(state.p_odom[0] - 14.0 * SPEED) < 3.5 * np.sqrt(state.covariance[POSITION.start, POSITION.start])


def test_wheels_that_get_stuck_while_nothing_else_sees_are_dropped(rng):
    """After a while on the IMU alone no speed could be told from a wrong one: the stuck ones never count again."""
    wheels = speeds(rng, 30.0)
    v = wheels.v_body.copy()
    v[wheels.stamps_ns > START_NS + 6 * 10**9, 0] = 0.0
    updates, state = drive(rng, replace(wheels, v_body=v), seconds=30.0)
    assert not updates.trust.believed
    assert updates.trust.untold > 0
    assert [event.code for event in updates.taken_events()] == ["wheel-slip", "wheel-doubt"]
    assert abs(state.v_odom[0] - SPEED) < 3.5 * np.sqrt(state.covariance[VELOCITY.start, VELOCITY.start])


def test_speeds_that_have_been_heard_do_not_count_again(rng):
    config = WheelConfig()
    truth, _ = begin(rng, config)
    updates = SpeedUpdates(config)
    updates.observe(speeds(rng, 3.0))
    updates.trust = replace(updates.trust, believed=True)
    imu = ImuBatch(
        stamps_ns=np.arange(START_NS, START_NS + STEP_NS + 1, 10**7), gyro=np.zeros((11, 3)),
        accel=np.tile([0.0, 0.0, G], (11, 1)), received_ns=START_NS,
    )  # fmt: skip
    ahead = predict(begin(rng, config)[1], imu, START_NS + STEP_NS, noise=NOISE, config=ImuConfig())
    assert updates.updated(ahead.state, ahead.path, None, sees=True) is not None
    assert updates.updated(ahead.state, ahead.path, None, sees=True) is None
    assert truth.stamp_ns == START_NS


def test_wheels_that_stand_prove_no_rest(rng):
    """A belt carries the body on at 2 cm/s while its wheels stand: what they say for a minute is no certain zero."""
    config, belt, calm = WheelConfig(), 0.02, replace(NOISE, accel=1e-3, accel_walk=1e-5, gyro=2e-5)
    wheels = speeds(rng, 12.0, noise=0.0, speed=0.0)
    truth, state = begin(rng, config, speed=belt)
    sure = np.where(np.isin(np.arange(26), np.r_[0:3, ACCEL_BIAS, GRAVITY]), 0.02, 1.0)  # of level and force
    begun = truth, replace(truth, v_odom=state.v_odom, covariance=sure[:, None] * state.covariance * sure)
    updates = SpeedUpdates(config)
    updates.trust = replace(updates.trust, believed=True)
    updates, state = drive(rng, wheels, seconds=12.0, seen=0.0, begun=begun, updates=updates, imu_noise=calm)
    assert updates.trust.used > 100
    sigma = np.sqrt(state.covariance[VELOCITY.start, VELOCITY.start])
    assert abs(state.v_odom[0] - belt) < 2.0 * sigma
    assert 0.01 < sigma < 0.03


def test_slip_that_sets_in_slowly_is_told_by_the_mean_of_its_innovations(rng):
    """Each speed passes its own test; what the wheels feign is found before it has carried the velocity far."""
    sure = replace(NOISE, accel=5e-3, accel_walk=1e-4, gyro=1e-4, gyro_walk=1e-6)
    wheels = speeds(rng, 30.0, noise=0.01)
    v, later = wheels.v_body.copy(), 1e-9 * (wheels.stamps_ns - START_NS) - 20.0
    v[:, 0] *= 1.0 + 0.02 * np.maximum(later, 0.0)
    updates, state = drive(rng, replace(wheels, v_body=v), seconds=30.0, seen=18.0, imu_noise=sure)
    told = [event for event in updates.taken_events() if event.code == "wheel-doubt"]
    assert "drift away" in told[0].message
    assert updates.trust.barred
    assert abs(state.v_odom[0] - SPEED) < 0.15  # the wheels have come to 0.4
