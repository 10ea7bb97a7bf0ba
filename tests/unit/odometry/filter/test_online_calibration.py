"""Mounting and clock as states: found in general motion, left alone where the motion tells nothing about them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.cloud import deskew
from heliograph.config import ImuConfig, RunConfig
from heliograph.data import ImuBatch, NavState, Rig, Scan
from heliograph.data.error_layout import CALIBRATION, CLOCK, DRIFT
from heliograph.errors import ConfigError
from heliograph.imu import propagate
from heliograph.imu.clock_shift import clock_shift
from heliograph.lie import so3
from heliograph.odometry import FilterOdometry
from heliograph.odometry.filter.calibrating import calibration_of, with_calibration
from heliograph.odometry.filter.calibration_gate import CalibrationGate
from heliograph.odometry.filter.error_state import local, retract
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.motion import MotionModel, rate_change, sweep_path
from heliograph.odometry.filter.remounting import anchoring
from heliograph.odometry.filter.update import iterated_update
from heliograph.registration import NormalEquations
from heliograph.sim import SCENARIOS, simulate
from heliograph.testing import assert_jacobian
from online_trials import online_trial, prior_sigma
from states import NOISE, START_NS, random_imu, random_rotation, random_state, rest_state, resting

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


def transition_column(motion, state, imu, end_ns, index):
    """Of what a prediction makes of the covariance: the derivative of its errors by one of those before."""
    one = np.zeros_like(state.covariance)
    one[index, index] = 1.0
    growth = motion.predict(state, imu, end_ns).growth
    return (growth.grown(one) - growth.grown(np.zeros_like(one)))[:, index]


@pytest.mark.parametrize("seed", range(3))
def test_clock_shift_is_the_derivative_of_the_prediction(seed):
    rng = np.random.default_rng(seed)
    state, imu = replace(random_state(rng, dim=25), imu_offset=0.0), smooth_imu(rng)
    motion, end_ns = MotionModel(EXACT, FILTER, QUIET), START_NS + 100_000_000
    ahead = motion.predict(state, imu, end_ns).state

    def moved(offset):
        return local(ahead, motion.predict(replace(state, imu_offset=float(offset[0])), imu, end_ns).state)

    expected = transition_column(motion, state, imu, end_ns, CLOCK)
    # The signals are means over 30 ms, which takes 0.3 % off what changes as fast as these do.
    assert_jacobian(moved, np.zeros(1), expected[:, None], step=1e-5, rtol=1e-2, atol=2e-2)
    assert np.abs(expected[[0, 1, 2, 6, 7, 8]]).max() > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_drift_moves_the_offset_and_by_half_of_it_the_prediction(seed):
    """The half holds where rate and force change evenly, and the frames they are in turn by little meanwhile."""
    rng = np.random.default_rng(seed)
    state, imu = replace(random_state(rng, dim=25), imu_offset=0.0), smooth_imu(rng)
    t = (imu.stamps_ns - START_NS)[:, None] * 1e-9
    imu = replace(imu, gyro=rng.normal(size=3) + 10.0 * t * rng.normal(size=3), accel=50.0 * t * rng.normal(size=3))
    motion, end_ns = MotionModel(EXACT, FILTER, QUIET), START_NS + 20_000_000
    ahead = motion.predict(state, imu, end_ns).state

    def moved(drift):
        changed = replace(state, imu_drift=state.imu_drift + float(drift[0]))
        return local(ahead, motion.predict(changed, imu, end_ns).state)

    expected = transition_column(motion, state, imu, end_ns, DRIFT)
    assert expected[CLOCK] == pytest.approx(0.02)
    assert expected[DRIFT] == 1.0
    assert_jacobian(moved, np.zeros(1), expected[:, None], step=1e-3, rtol=2e-2, atol=1e-4)
    assert np.abs(expected[0:3]).max() > 5e-4
    assert np.abs(expected[6:9]).max() > 5e-3


def test_prediction_with_the_true_clock_is_that_of_true_stamps(rng):
    """Over several intervals, each with the offset that the one before it left."""
    state, imu = random_state(rng, dim=25), smooth_imu(rng)
    late = replace(imu, stamps_ns=state.imu_clock.imu_time(imu.stamps_ns))
    motion = MotionModel(EXACT, FILTER, QUIET)
    exact, drifting = replace(state, imu_offset=0.0, imu_drift=0.0), state
    for end_ns in START_NS + np.array([60, 120, 200]) * 1_000_000:
        exact, drifting = (motion.predict(s, i, int(end_ns)).state for s, i in ((exact, imu), (drifting, late)))
    np.testing.assert_allclose(local(exact, drifting)[:17], 0.0, atol=1e-7)
    assert drifting.imu_offset == pytest.approx(state.imu_offset + 0.2 * state.imu_drift, rel=1e-12)
    assert drifting.imu_drift == state.imu_drift


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
        covariance=np.zeros((25, 25)),
    )  # fmt: skip
    after, _ = propagate(state, imu, START_NS + 100_000_000, noise=NOISE, config=ImuConfig())
    np.testing.assert_array_equal(clock_shift(state, after, imu, np.eye(17), NOISE), 0.0)
    turning = replace(imu, gyro=imu.gyro + np.linspace(0.0, 1.0, 60)[:, None])
    assert np.abs(clock_shift(state, after, turning, np.eye(17), NOISE)[:3]).min() > 0.1


def test_offset_within_the_sweep_acts_as_a_bias_of_minus_the_rates_change(rng):
    state, imu = random_state(rng, dim=25), random_imu(rng)
    after, path = propagate(state, imu, START_NS + 100_000_000, noise=NOISE, config=ImuConfig())
    late = sweep_path(path, after, replace(after, imu_offset=after.imu_offset + 0.002))
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
    state, imu = random_state(rng, dim=25), smooth_imu(rng)
    state, imu = replace(state, gyro_bias=np.zeros(3)), replace(imu, gyro=0.1 * imu.gyro)
    after, path = propagate(state, imu, START_NS + 100_000_000, noise=QUIET, config=ImuConfig())
    raw = rng.uniform(-20.0, 20.0, (1, 3)).astype(np.float32)
    n, before = random_rotation(rng)[:, 0], 0.08

    def seen(offset):
        sweep = sweep_path(path, after, replace(after, imu_offset=after.imu_offset + float(offset[0])))
        return deskew(
            raw, np.array([20_000_000], np.int32), stamp_ns=START_NS, path_stamps_ns=sweep.stamps_ns,
            R_odom_body=sweep.R_odom_imu, p_odom=sweep.p_odom, T_body_lidar=np.eye(4), threads=1,
        )[0].astype(np.float64)  # fmt: skip

    m = after.R_odom_imu.T @ n
    turn = np.cross(seen([0.0]), m)
    J = np.concatenate([turn, n, -before * n, before * turn])
    measurement = ScanMeasurement.of(_equations(J, 0.5)).with_clock(rate_change(path))
    A, b = measurement.information, measurement.gradient
    np.testing.assert_array_equal(measurement.columns, [*range(12), CLOCK])
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
        information=np.outer(J, J), gradient=J * r, feigned=0.0 * np.outer(J, J), feigned_square=0.0,
        blocks=("pose", "motion"), weight=1.0, robust_weight=1.0,
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

    columns = np.arange(25)

    def __init__(self, H, r):
        self.information, self.gradient = H.T @ H, H.T @ r


def test_considered_direction_keeps_value_and_sigma_and_the_rest_is_schmidts(rng):
    """Against the textbook's form with the measurement's own size, in a basis in which the direction is one axis."""
    state = replace(random_state(rng, dim=25), covariance=1e-4 * np.eye(25) + 1e-5)
    H, r = rng.normal(size=(8, 25)), 1e-3 * rng.normal(size=8)
    direction = np.zeros(25)
    direction[20:24] = rng.normal(size=4)
    direction /= np.linalg.norm(direction)
    projection = np.outer(direction, direction)
    found = iterated_update(
        state, lambda *_: Linear(H, r), max_iterations=1, tolerance_rotation=1.0, tolerance_position=1.0,
        considered=projection,
    ).state  # fmt: skip
    P, free = state.covariance, np.eye(25) - projection
    K = free @ P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(8))
    expected = (np.eye(25) - K @ H) @ P @ (np.eye(25) - K @ H).T + K @ K.T
    delta = local(state, found)
    np.testing.assert_allclose(delta, -K @ r, atol=1e-10)
    assert abs(direction @ delta) < 1e-15
    # The reset of the rotations by a step of less than a milliradian is all that differs.
    np.testing.assert_allclose(found.covariance, expected, rtol=2e-3, atol=1e-8)
    assert direction @ found.covariance @ direction == pytest.approx(direction @ P @ direction, rel=1e-12)


PRIOR = np.append(np.full(17, 0.1), prior_sigma(FILTER))


def gate_of(covariance):
    state = replace(random_state(np.random.default_rng(0), dim=25), covariance=covariance)
    return CalibrationGate.at_start(state, BOTH)


def test_gate_opens_the_direction_that_was_measured_and_no_other(rng):
    prior = np.diag(PRIOR**2)
    gate = gate_of(prior)
    np.testing.assert_allclose(gate.directions()[0], 1.0)
    np.testing.assert_allclose(gate.considered()[CALIBRATION, CALIBRATION], np.eye(8), atol=1e-12)
    h = np.zeros(25)
    h[[17, 20, 23]] = 1.0 / np.array([0.05, 0.1, 0.02])
    for _ in range(50):
        gate = gate.updated(Linear(3.0 * h[None], np.zeros(1)))
    gains, directions = gate.directions()
    np.testing.assert_allclose(gains[:7], 1.0, atol=1e-9)
    assert gains[7] > BOTH.calibration_gain
    np.testing.assert_allclose(np.abs(directions[[0, 3, 6], 7]), np.sqrt(1.0 / 3.0), atol=1e-6)
    free = np.eye(25) - gate.considered()
    np.testing.assert_allclose(free @ free, free, atol=1e-9)
    assert np.linalg.matrix_rank(free[CALIBRATION, CALIBRATION], tol=1e-6) == 1


def test_gate_does_not_count_what_a_pose_could_explain_as_well(rng):
    prior = np.diag(np.append(np.full(17, 1e3), PRIOR[17:]) ** 2)
    gate = gate_of(prior)
    H = np.zeros((3, 25))
    H[:, 0:3], H[:, 17:20] = 100.0 * np.eye(3), 100.0 * random_rotation(rng)
    for _ in range(20):
        gate = gate.updated(Linear(H, np.zeros(3)))
    np.testing.assert_allclose(gate.directions()[0], 1.0, atol=1e-3)


def test_a_long_rest_opens_nothing():
    """The drift's uncertainty adds to that of the offset meanwhile, and correlates both; neither is knowledge."""
    config = replace(FILTER, estimate_time_offset=True)
    state, motion = with_calibration(rest_state(), config), MotionModel(ImuConfig(), config, NOISE)
    gate, imu = CalibrationGate.at_start(state, config), resting(1200.0)
    gate = gate.predicted(motion.predict(state, imu, START_NS + 1_200_000_000_000).growth)
    np.testing.assert_array_equal(gate.directions()[0], 1.0)
    np.testing.assert_allclose(gate.considered()[CALIBRATION, CALIBRATION], np.diag(np.r_[np.zeros(6), 1.0, 1.0]))
    assert np.sqrt(gate.covariance[CLOCK, CLOCK]) == pytest.approx(np.hypot(0.02, 1200.0 * 50e-6), rel=1e-9)


def test_gate_opens_the_offset_before_the_drift_and_the_drift_by_how_the_offset_changes():
    config = replace(FILTER, estimate_time_offset=True)
    state, motion = with_calibration(rest_state(), config), MotionModel(ImuConfig(), config, NOISE)
    gate, imu = CalibrationGate.at_start(state, config), resting(20.0)
    h, opened, since = np.zeros((1, 25)), [], []
    h[0, CLOCK] = 1.0 / 0.5e-3
    for seconds in np.arange(0.1, 20.0, 0.1):
        end_ns = START_NS + round(1e9 * seconds)
        gate = gate.predicted(motion.predict(state, imu, end_ns).growth).updated(Linear(h, np.zeros(1)))
        state = replace(state, stamp_ns=end_ns)
        shut = np.diag(gate.considered())[[CLOCK, DRIFT]]
        opened.append(tuple(shut < 0.5))
        since.append(seconds)
    assert opened[0] == (True, False)
    assert opened[-1] == (True, True)
    # A line through samples of 0.5 ms every 0.1 s is known to 10 ppm, a fifth of the prior, after 15 s.
    known = np.sqrt(12.0) * 0.5e-3 * np.sqrt(0.1) / np.array(since) ** 1.5
    assert since[opened.index((True, True))] == pytest.approx(np.interp(-10e-6, -known, since), rel=0.05)


def test_offset_follows_a_drift_that_is_only_considered_and_knows_how_well():
    """Against the textbook's recursion for offset and drift alone, and against errors drawn from the prior."""
    config = replace(FILTER, estimate_time_offset=True)
    motion, imu, sigma, span = MotionModel(ImuConfig(), config, NOISE), resting(60.0), 1e-3, 1.0
    shut, h = np.zeros((25, 25)), np.zeros((1, 25))
    shut[DRIFT, DRIFT], h[0, CLOCK] = 1.0, 1.0 / sigma
    F, P = np.array([[1.0, span], [0.0, 1.0]]), np.diag([0.02, 50e-6]) ** 2
    rng = np.random.default_rng(7)
    offset, drift = 0.02 * rng.normal(size=15), 50e-6 * rng.normal(size=15)
    states = [with_calibration(rest_state(), config)] * len(offset)
    for k in range(1, 60):
        end_ns, true = START_NS + round(1e9 * span * k), offset + drift * span * k
        P = F @ P @ F.T
        K = P[:, :1] / (P[0, 0] + sigma**2) * [[1.0], [0.0]]
        P = (np.eye(2) - K @ [[1.0, 0.0]]) @ P @ (np.eye(2) - K @ [[1.0, 0.0]]).T + sigma**2 * K @ K.T
        states = [
            _measured(motion.predict(s, imu, end_ns).state, t + sigma * rng.normal(), h, shut)
            for s, t in zip(states, true, strict=True)
        ]
    np.testing.assert_allclose(states[0].covariance[23:, 23:], P, rtol=1e-9)
    assert {s.imu_drift for s in states} == {0.0}
    squares = [(t - s.imu_offset) ** 2 / s.covariance[CLOCK, CLOCK] for s, t in zip(states, true, strict=True)]
    assert chi2.ppf(0.01, 15) < np.sum(squares) < chi2.ppf(0.99, 15)
    # Neither as certain as if there were no drift, nor as lost as if nothing had been measured since the start.
    assert 2.0 * sigma / np.sqrt(59) < np.sqrt(P[0, 0]) < 0.25 * 50e-6 * 60.0


def _measured(prior, offset, h, considered):
    residual = h[0, CLOCK] * np.array([prior.imu_offset - offset])
    return iterated_update(
        prior, lambda *_: Linear(h, residual), max_iterations=1, tolerance_rotation=1.0, tolerance_position=1.0,
        considered=considered,
    ).state  # fmt: skip


def test_what_is_not_estimated_has_no_direction():
    state = replace(random_state(np.random.default_rng(0)), covariance=np.eye(17))
    assert with_calibration(state, FILTER) is state
    assert calibration_of(state, FILTER).account(state) is None
    config = replace(FILTER, estimate_time_offset=True)
    gate = CalibrationGate.at_start(with_calibration(state, config), config)
    gains, directions = gate.directions()
    assert gains.shape == (2,)
    np.testing.assert_array_equal(np.abs(directions), np.eye(8)[:, 6:])
    config = replace(config, time_drift_sigma_ppm=0.0)
    gains, directions = CalibrationGate.at_start(with_calibration(state, config), config).directions()
    np.testing.assert_array_equal(np.abs(directions), np.eye(8)[:, 6:7])


def test_anchoring_is_the_derivative_of_the_change_of_frame(rng):
    state = random_state(rng, dim=25)

    def seen(e):
        """Errors in the frame in which the pose has none."""
        moved = retract(state, e)
        turn = state.R_odom_imu @ moved.R_odom_imu.T
        there = replace(
            moved, R_odom_imu=state.R_odom_imu, p_odom=state.p_odom, v_odom=turn @ moved.v_odom,
            g_odom=turn @ moved.g_odom,
        )  # fmt: skip
        return local(state, there)

    assert_jacobian(seen, np.zeros(25), anchoring(state), rtol=1e-6, atol=1e-7)


def test_settings_are_checked():
    with pytest.raises(ConfigError, match="calibration_gain"):
        replace(FILTER, calibration_gain=0.5)
    with pytest.raises(ConfigError, match="time_offset_sigma"):
        replace(FILTER, time_offset_sigma=0.0)
    for ppm in (-1.0, 1e6):
        with pytest.raises(ConfigError, match="time_drift_sigma_ppm"):
            replace(FILTER, time_drift_sigma_ppm=ppm)


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
    assert found.kept_names == ("clock drift",)
    # Before the motion the clock was left alone, with its sigma.
    early = results[8].calibration
    assert (early.imu_offset, early.imu_drift) == (0.0, 0.0)
    assert early.sigma[6] == pytest.approx(FILTER.time_offset_sigma, rel=1e-5)
    event = next(e for e in odometry.events if e.code == "online-calibration")
    assert "clock offset" in event.message
    assert "drift 0.0 +- 50.0 ppm" in event.message


def test_at_rest_all_stay_at_their_prior():
    trial = online_trial("rest", 1, duration=5.0)
    known_since = (trial.found.stamp_ns - trial.results[0].calibration.stamp_ns) * 1e-9
    sigma = trial.prior_sigma
    assert np.hypot(sigma[6], sigma[7] * known_since) < trial.found.sigma[6] < np.hypot(sigma[6], sigma[7] * 5.0)
    np.testing.assert_allclose(np.delete(trial.found.sigma, 6), np.delete(sigma, 6), rtol=1e-9)
    np.testing.assert_allclose(trial.error, trial.first_error, atol=1e-12)
    assert trial.found.kept.all()
    assert len(trial.found.kept_names) == 8
    assert so3.log(trial.found.T_imu_lidar[:3, :3]).shape == (3,)
