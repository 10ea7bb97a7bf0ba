"""Mounting and clock as states: found in general motion, left alone where the motion tells nothing about them."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.cloud import deskew
from heliograph.config import ImuConfig, RunConfig
from heliograph.data import ImuBatch, NavState, Rig, Scan
from heliograph.errors import ConfigError
from heliograph.imu import propagate
from heliograph.imu.clock_shift import clock_shift
from heliograph.lie import so3
from heliograph.odometry import FilterOdometry
from heliograph.odometry.calibration_gate import CALIBRATION, CalibrationGate, with_calibration
from heliograph.odometry.error_state import local, retract
from heliograph.odometry.matching import with_clock
from heliograph.odometry.motion import MotionModel, rate_change, sweep_path
from heliograph.odometry.remounting import anchoring
from heliograph.odometry.update import iterated_update
from heliograph.registration import NormalEquations
from heliograph.sim import SCENARIOS, simulate
from heliograph.testing import assert_jacobian
from online_trials import online_trial
from states import NOISE, START_NS, random_imu, random_rotation, random_state

EXACT = replace(ImuConfig(), curvature=0.0, max_step=0.0005)
QUIET = replace(NOISE, gyro=1e-6, accel=1e-5)
FILTER = RunConfig().filter
BOTH = replace(FILTER, estimate_mounting=True, estimate_time_offset=True)


def smooth_imu(rng, rate=4000.0):
    """Signals that hardly change within the window that the speed of the state is a mean over."""
    stamps = START_NS + (np.arange(-0.1, 0.3, 1.0 / rate) * 1e9).astype(np.int64)
    t = (stamps - START_NS)[:, None] * 1e-9
    w, phase = rng.uniform(3.0, 8.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
    gyro = 1.5 * np.sin(w[0] * t + phase[0])
    accel = np.array([0.0, 0.0, 9.8]) + 4.0 * np.sin(w[1] * t + phase[1])
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=0)


@pytest.mark.parametrize("seed", range(3))
def test_clock_shift_is_the_derivative_of_the_prediction(seed):
    rng = np.random.default_rng(seed)
    state, imu = random_state(rng, dim=24), smooth_imu(rng)
    motion, end_ns = MotionModel(EXACT, FILTER, QUIET), START_NS + 100_000_000
    ahead, _ = motion.predict(state, imu, end_ns)

    def moved(offset):
        late, _ = motion.predict(replace(state, imu_offset=float(offset[0])), imu, end_ns)
        return local(replace(ahead, imu_offset=late.imu_offset), late)[:17]

    J = ahead.covariance[:17, 23] - _without_clock(state, imu, end_ns)
    expected = J / state.covariance[23, 23]
    # The signals are means over 30 ms, which takes 0.3 % off what changes as fast as these do.
    assert_jacobian(moved, np.zeros(1), expected[:, None], step=1e-5, rtol=1e-2, atol=2e-2)
    assert np.abs(expected[[0, 1, 2, 6, 7, 8]]).max() > 0.5


def _without_clock(state, imu, end_ns):
    """What the transition alone makes of the clock's correlations."""
    mute = replace(state, covariance=state.covariance[:23, :23])
    mute.covariance[17:20, :] = state.covariance[[23, 23, 23], :23]
    mute.covariance[:, 17:20] = state.covariance[:23, [23, 23, 23]]
    moved, _ = propagate(mute, imu, end_ns, noise=QUIET, config=EXACT)
    return moved.covariance[:17, 17]


def test_clock_shift_at_rest_is_nothing_but_noise_and_left_out(rng):
    stamps = START_NS + np.arange(-10, 50) * 5_000_000
    noise = np.sqrt(200.0) * rng.normal(size=(2, 60, 3))
    imu = ImuBatch(
        stamps_ns=stamps,
        gyro=NOISE.gyro * noise[0],
        accel=np.array([0.0, 0.0, 9.80665]) + NOISE.accel * noise[1],
        received_ns=0,
    )
    state = NavState(
        stamp_ns=START_NS, R_odom_imu=np.eye(3), p_odom=np.zeros(3), v_odom=np.zeros(3), gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3), g_odom=np.array([0.0, 0.0, -9.80665]), T_imu_lidar=np.eye(4),
        covariance=np.zeros((24, 24)),
    )  # fmt: skip
    after, _ = propagate(state, imu, START_NS + 100_000_000, noise=NOISE, config=ImuConfig())
    np.testing.assert_array_equal(clock_shift(state, after, imu, np.eye(17), NOISE), 0.0)
    turning = replace(imu, gyro=imu.gyro + np.linspace(0.0, 1.0, 60)[:, None])
    assert np.abs(clock_shift(state, after, turning, np.eye(17), NOISE)[:3]).min() > 0.1


def test_offset_within_the_sweep_acts_as_a_bias_of_minus_the_rates_change(rng):
    state, imu = random_state(rng, dim=24), random_imu(rng)
    after, path = propagate(state, imu, START_NS + 100_000_000, noise=NOISE, config=ImuConfig())
    late = sweep_path(path, after, replace(after, imu_offset=0.002))
    biased = sweep_path(path, after, replace(after, gyro_bias=after.gyro_bias - 0.002 * rate_change(path)))
    np.testing.assert_allclose(late.R_odom_imu, biased.R_odom_imu, atol=1e-12)
    assert np.abs(late.R_odom_imu - path.R_odom_imu).max() > 1e-5
    np.testing.assert_allclose(late.R_odom_imu[-1], after.R_odom_imu, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_column_of_the_clock_is_the_derivative_of_the_deskewed_residual(seed):
    """From a raw point through the sweep as a state has it to the residual, at a large pose.

    Like that of the gyroscope's bias, the column neglects how far the sweep itself turns; here that is little.
    """
    rng = np.random.default_rng(seed)
    state, imu = random_state(rng, dim=24), smooth_imu(rng)
    state, imu = replace(state, gyro_bias=np.zeros(3)), replace(imu, gyro=0.1 * imu.gyro)
    after, path = propagate(state, imu, START_NS + 100_000_000, noise=QUIET, config=ImuConfig())
    raw = rng.uniform(-20.0, 20.0, (1, 3)).astype(np.float32)
    n, before = random_rotation(rng)[:, 0], 0.08

    def seen(offset):
        sweep = sweep_path(path, after, replace(after, imu_offset=float(offset[0])))
        return deskew(
            raw, np.array([20_000_000], np.int32), stamp_ns=START_NS, path_stamps_ns=sweep.stamps_ns,
            R_odom_body=sweep.R_odom_imu, p_odom=sweep.p_odom, T_body_lidar=np.eye(4), threads=1,
        )[0].astype(np.float64)  # fmt: skip

    m = after.R_odom_imu.T @ n
    turn = np.cross(seen([0.0]), m)
    J = np.concatenate([turn, n, -before * n, before * turn])
    equations = with_clock(_equations(J, 0.5), rate_change(path))
    A, b = equations.information, equations.gradient
    column = A[12, 3:6] @ n
    assert b[12] == pytest.approx(0.5 * column)
    assert A[12, 12] == pytest.approx(column**2)
    # float32 points: a step of 50 ms moves them by far more than their rounding, and the turn is still small.
    numeric = m @ (seen([0.05]) - seen([-0.05])) / 0.1
    assert numeric == pytest.approx(column, rel=2e-2, abs=2e-2)
    assert abs(column) > 0.1


def _equations(J, r):
    """The sums over one residual with unit noise."""
    return NormalEquations(
        information=np.outer(J, J), gradient=J * r, columns=np.arange(12), weight=1.0, robust_weight=1.0,
        square=r * r, cost=0.5 * r * r, matches=1, fallback_matches=0, queries=1,
    )  # fmt: skip


def test_rate_change_of_an_even_acceleration_is_that_acceleration():
    stamps = START_NS + np.arange(0, 101) * 1_000_000
    t = (stamps - START_NS)[:, None] * 1e-9
    imu = ImuBatch(stamps_ns=stamps, gyro=t * [0.0, 0.0, 7.0], accel=np.zeros((101, 3)), received_ns=0)
    state = random_state(np.random.default_rng(1))
    state = replace(state, gyro_bias=np.zeros(3))
    _, path = propagate(state, imu, int(stamps[-1]), noise=NOISE, config=ImuConfig())
    np.testing.assert_allclose(rate_change(path), [0.0, 0.0, 7.0], rtol=1e-3, atol=1e-6)


class Linear:
    """A measurement of a linear combination of all errors, with unit noise."""

    columns = np.arange(24)

    def __init__(self, H, r):
        self.information, self.gradient = H.T @ H, H.T @ r


def test_considered_direction_keeps_value_and_sigma_and_the_rest_is_schmidts(rng):
    """Against the textbook's form with the measurement's own size, in a basis in which the direction is one axis."""
    state = replace(random_state(rng, dim=24), covariance=1e-4 * np.eye(24) + 1e-5)
    H, r = rng.normal(size=(8, 24)), 1e-3 * rng.normal(size=8)
    direction = np.zeros(24)
    direction[20:24] = rng.normal(size=4)
    direction /= np.linalg.norm(direction)
    projection = np.outer(direction, direction)
    found = iterated_update(
        state, lambda *_: Linear(H, r), max_iterations=1, tolerance_rotation=1.0, tolerance_position=1.0,
        considered=projection,
    ).state  # fmt: skip
    P, free = state.covariance, np.eye(24) - projection
    K = free @ P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(8))
    expected = (np.eye(24) - K @ H) @ P @ (np.eye(24) - K @ H).T + K @ K.T
    delta = local(state, found)
    np.testing.assert_allclose(delta, -K @ r, atol=1e-10)
    assert abs(direction @ delta) < 1e-15
    # The reset of the rotations by a step of less than a milliradian is all that differs.
    np.testing.assert_allclose(found.covariance, expected, rtol=2e-3, atol=1e-8)
    assert direction @ found.covariance @ direction == pytest.approx(direction @ P @ direction, rel=1e-12)


def gate_of(covariance):
    state = replace(random_state(np.random.default_rng(0), dim=24), covariance=covariance)
    return CalibrationGate.at_start(state, BOTH)


def test_gate_opens_the_direction_that_was_measured_and_no_other(rng):
    prior = np.diag(np.repeat([0.1, 0.05, 0.1, 0.02], [17, 3, 3, 1]) ** 2)
    gate = gate_of(prior)
    np.testing.assert_allclose(gate.directions()[0], 1.0)
    np.testing.assert_allclose(gate.considered()[CALIBRATION, CALIBRATION], np.eye(7), atol=1e-12)
    h = np.zeros(24)
    h[[17, 20, 23]] = 1.0 / np.array([0.05, 0.1, 0.02])
    for _ in range(50):
        gate = gate.updated(Linear(3.0 * h[None], np.zeros(1)))
    gains, directions = gate.directions()
    np.testing.assert_allclose(gains[:6], 1.0, atol=1e-9)
    assert gains[6] > BOTH.calibration_gain
    np.testing.assert_allclose(np.abs(directions[[0, 3, 6], 6]), np.sqrt(1.0 / 3.0), atol=1e-6)
    free = np.eye(24) - gate.considered()
    np.testing.assert_allclose(free @ free, free, atol=1e-9)
    assert np.linalg.matrix_rank(free[CALIBRATION, CALIBRATION], tol=1e-6) == 1


def test_gate_does_not_count_what_a_pose_could_explain_as_well(rng):
    prior = np.diag(np.repeat([1e3, 0.05, 0.1, 0.02], [17, 3, 3, 1]) ** 2)
    gate = gate_of(prior)
    H = np.zeros((3, 24))
    H[:, 0:3], H[:, 17:20] = 100.0 * np.eye(3), 100.0 * random_rotation(rng)
    for _ in range(20):
        gate = gate.updated(Linear(H, np.zeros(3)))
    np.testing.assert_allclose(gate.directions()[0], 1.0, atol=1e-3)


def test_what_is_not_estimated_has_no_direction():
    state = replace(random_state(np.random.default_rng(0)), covariance=np.eye(17))
    assert with_calibration(state, FILTER) is state
    assert CalibrationGate.at_start(state, FILTER) is None
    config = replace(FILTER, estimate_time_offset=True)
    gate = CalibrationGate.at_start(with_calibration(state, config), config)
    gains, directions = gate.directions()
    assert gains.shape == (1,)
    np.testing.assert_array_equal(np.abs(directions[:, 0]), np.eye(7)[6])


def test_anchoring_is_the_derivative_of_the_change_of_frame(rng):
    state = random_state(rng, dim=24)

    def seen(e):
        """Errors in the frame in which the pose has none."""
        moved = retract(state, e)
        turn = state.R_odom_imu @ moved.R_odom_imu.T
        there = replace(
            moved, R_odom_imu=state.R_odom_imu, p_odom=state.p_odom, v_odom=turn @ moved.v_odom,
            g_odom=turn @ moved.g_odom,
        )  # fmt: skip
        return local(state, there)

    assert_jacobian(seen, np.zeros(24), anchoring(state), rtol=1e-6, atol=1e-7)


def test_settings_are_checked():
    with pytest.raises(ConfigError, match="calibration_gain"):
        replace(FILTER, calibration_gain=0.5)
    with pytest.raises(ConfigError, match="time_offset_sigma"):
        replace(FILTER, time_offset_sigma=0.0)


def test_time_offset_alone_is_found_and_the_mounting_is_not_touched():
    simulation = simulate(
        SCENARIOS["calibration"].thinned(beams=16, columns=180, duration=6.0).varied(imu={"clock_offset": 0.015}), 3
    )
    config = RunConfig(
        cloud=replace(RunConfig().cloud, target_points=1200), filter=replace(FILTER, estimate_time_offset=True)
    )
    rig = Rig(T_imu_lidar=simulation.rig.T_imu_lidar, source="true")
    odometry = FilterOdometry(config, rig, sensors=frozenset({"lidar", "imu"}))
    results = [r for record in simulation for r in odometry.add(record)] + odometry.finish()
    found = results[-1].calibration
    assert len(results) == sum(isinstance(record, Scan) for record in simulation)
    assert abs(found.imu_offset - 0.015) < 0.0015
    assert found.sigma[6] < 0.0015
    np.testing.assert_array_equal(found.T_imu_lidar, simulation.rig.T_imu_lidar)
    assert not found.kept_names
    # Before the motion the clock was left alone, with its sigma.
    assert results[8].calibration.imu_offset == 0.0
    assert results[8].calibration.sigma[6] == pytest.approx(FILTER.time_offset_sigma, rel=1e-9)
    event = next(e for e in odometry.events if e.code == "online-calibration")
    assert "clock offset" in event.message


def test_at_rest_all_stay_at_their_prior():
    trial = online_trial("rest", 1, duration=5.0)
    np.testing.assert_allclose(trial.found.sigma, trial.prior_sigma, rtol=1e-9)
    np.testing.assert_allclose(trial.error, trial.first_error, atol=1e-12)
    assert trial.found.kept.all()
    assert len(trial.found.kept_names) == 7
    assert so3.log(trial.found.T_imu_lidar[:3, :3]).shape == (3,)
