"""The filter's first state: at rest, in motion, without an IMU, and how honest its covariance is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Rig, Scan
from heliograph.data.error_layout import VELOCITY
from heliograph.lie import s2, so3
from heliograph.odometry.filter.error_state import local
from heliograph.odometry.filter.opening import lidar_only, scans_of
from heliograph.odometry.filter.rest import rest_explains
from heliograph.odometry.filter.start import _aligned_state, find_start, look
from heliograph.odometry.sequencer import Packet
from heliograph.sim import SCENARIOS, simulate
from moving import CONFIG as EXACT_IMU
from moving import Trial
from states import GRAVITY, START_NS, random_rotation

CONFIG = RunConfig()
EXACT = replace(CONFIG, imu=EXACT_IMU)
RIG = Rig(T_imu_lidar=np.eye(4), source="test")
NO_GAIT = {"bounce": 0.0, "lateral": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}


def resting_imu(rng, *, up, gyro_bias, accel_bias, duration=1.0, rate=200.0, accel_noise=2e-3):
    n = int(duration * rate) + 1
    stamps = START_NS + np.arange(n, dtype=np.int64) * int(1e9 / rate)
    gyro = gyro_bias + 2e-4 * np.sqrt(rate) * rng.normal(size=(n, 3))
    accel = GRAVITY * up + accel_bias + accel_noise * np.sqrt(rate) * rng.normal(size=(n, 3))
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=int(stamps[-1]))


def start_of(imu, rig=RIG):
    return find_start([Packet(scan=None, end_ns=int(imu.stamps_ns[0]) + 10**8)], imu, rig, CONFIG, threads=1)


def draw(rng, accel_noise=2e-3):
    up, gyro_bias = random_rotation(rng)[:, 2], rng.normal(scale=0.01, size=3)
    accel_bias = rng.normal(scale=CONFIG.imu.accel_bias_sigma, size=3)
    imu = resting_imu(rng, up=up, gyro_bias=gyro_bias, accel_bias=accel_bias, accel_noise=accel_noise)
    start = start_of(imu)
    state = start.state
    truth = replace(
        state, gyro_bias=gyro_bias, accel_bias=accel_bias, v_odom=np.zeros(3), g_odom=-GRAVITY * state.R_odom_imu @ up
    )
    return start, truth


def test_static_start_is_level_at_the_origin_and_heads_along_x(rng):
    for _ in range(10):
        start, truth = draw(rng)
        state = start.state
        assert start.events == ()
        assert start.motion.inertial
        tilt = np.arccos(np.clip(-truth.g_odom[2] / GRAVITY, -1.0, 1.0))
        assert tilt < 0.05  # the accelerometer's bias, nothing else
        np.testing.assert_allclose(state.p_odom, 0.0, atol=5e-3)
        np.testing.assert_allclose(state.R_odom_imu[1, 0], 0.0, atol=5e-3)
        np.testing.assert_allclose(state.gyro_bias, truth.gyro_bias, atol=2e-3)


def test_static_start_knows_that_a_bias_and_a_tilt_look_alike():
    """Errors of bias and gravity fit a covariance that holds them correlated: mean squared distance = dimension.

    The noise is large enough for the filter's allowance of 2 mm/s^2 for what is not white to play no part.
    """
    rng, draws = np.random.default_rng(7), 300
    squares, alone = [], []
    for _ in range(draws):
        start, truth = draw(rng, accel_noise=1e-2)
        error = local(start.state, truth)[12:17]
        P = start.state.covariance[12:17, 12:17]
        squares.append(error @ np.linalg.solve(P, error))
        alone.append(error[3:] @ np.linalg.solve(np.diag(np.diag(P)[3:]), error[3:]))
        strongest = np.abs(P[:3, 3:] / np.sqrt(np.outer(np.diag(P)[:3], np.diag(P)[3:]))).max()
        assert strongest > 0.5
    assert np.mean(squares) == pytest.approx(5.0, abs=4.0 * np.sqrt(10.0 / draws))
    assert np.mean(alone) == pytest.approx(2.0, abs=4.0 * np.sqrt(4.0 / draws))


def test_static_start_gyro_bias_sigma_covers_its_error():
    rng, squares = np.random.default_rng(9), []
    for _ in range(200):
        start, truth = draw(rng)
        error = local(start.state, truth)[9:12]
        squares.append(error @ np.linalg.solve(start.state.covariance[9:12, 9:12], error) / 3.0)
    assert 0.3 < np.mean(squares) < 1.2


def test_mounting_is_estimated_only_where_it_is_uncertain(rng):
    imu = resting_imu(rng, up=np.array([0.0, 0.0, 1.0]), gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
    assert start_of(imu).state.covariance.shape == (17, 17)
    unsure = replace(RIG, known=False, sigma_rotation=0.02, sigma_translation=0.1)
    P = start_of(imu, unsure).state.covariance
    np.testing.assert_allclose(np.diag(P)[17:], [4e-4] * 3 + [1e-2] * 3)


@pytest.mark.parametrize("rpy", [(0.0, 90.0, 30.0), (180.0, 0.0, 0.0), (45.0, 0.0, 77.0), (90.0, 0.0, 0.0)])
def test_any_mounting_starts_level(rng, rpy):
    R_world_imu = so3.from_rpy(*np.radians(rpy))
    imu = resting_imu(rng, up=R_world_imu.T @ [0.0, 0.0, 1.0], gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
    state = start_of(imu).state
    np.testing.assert_allclose(state.R_odom_imu.T @ [0, 0, 1], R_world_imu.T @ [0, 0, 1], atol=5e-3)
    assert np.isfinite(state.covariance).all()
    np.testing.assert_allclose(state.covariance, state.covariance.T, atol=1e-15)


def packets_and_imu(scenario, seed=1):
    simulation = simulate(scenario, seed)
    records = list(simulation)
    packets = [Packet(scan=r, end_ns=r.end_ns) for r in records if isinstance(r, Scan)]
    batches = [r for r in records if isinstance(r, ImuBatch)]
    imu = ImuBatch(
        stamps_ns=np.concatenate([b.stamps_ns for b in batches]),
        gyro=np.concatenate([b.gyro for b in batches]),
        accel=np.concatenate([b.accel for b in batches]),
        received_ns=batches[-1].received_ns,
    )
    return simulation, packets, imu


def start_in(walk, gait, sensors_imu=True):
    scenario = SCENARIOS["warehouse"].thinned(beams=24, columns=256).varied(walk=walk, gait=gait)
    simulation, packets, imu = packets_and_imu(scenario)
    if not sensors_imu:
        imu = replace(imu, stamps_ns=imu.stamps_ns[:0], gyro=imu.gyro[:0], accel=imu.accel[:0])
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1)
    return start, simulation.truth.motion(np.array([start.state.stamp_ns]))


def test_constant_speed_looks_still_to_the_imu_but_not_to_the_lidar():
    start, truth = start_in({"begin": 8.0, "duration": 1.3}, NO_GAIT)
    (event,) = start.events
    assert event.code == "start-moving"
    assert "although the IMU is calm" in event.message
    speed = np.linalg.norm(truth.v_world[0])
    assert speed > 1.4
    v_imu, v_true = start.state.R_odom_imu.T @ start.state.v_odom, truth.R_world_body[0].T @ truth.v_world[0]
    np.testing.assert_allclose(v_imu, v_true, atol=0.15)


def test_walking_start_finds_velocity_gravity_and_bias_within_its_sigmas():
    start, truth = start_in({"begin": 12.0, "duration": 1.3}, {})
    (event,) = start.events
    assert (event.code, event.severity) == ("start-moving", "info")
    assert "gyro spread" in event.message
    assert start.account.verdict == "fair"
    assert "accelerometer bias x, accelerometer bias y" in event.message
    state = start.state
    down = truth.R_world_body[0].T @ [0.0, 0.0, -1.0]
    found = state.R_odom_imu.T @ state.g_odom / GRAVITY
    tilt = np.linalg.norm(s2.local(found, down))
    assert tilt < 0.12
    assert tilt < 4.0 * np.sqrt(np.trace(state.covariance[15:17, 15:17]))
    v_error = state.R_odom_imu.T @ state.v_odom - truth.R_world_body[0].T @ truth.v_world[0]
    assert np.linalg.norm(v_error) < 3.0 * np.sqrt(np.trace(state.covariance[6:9, 6:9]))
    assert np.linalg.norm(v_error) < 0.5


def test_rest_agrees_with_the_lidar():
    start, _ = start_in({"duration": 1.3}, {})
    assert start.events == ()
    assert np.linalg.norm(start.state.v_odom) == 0.0


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("field", 2),
        pytest.param("bare-field", 1, marks=pytest.mark.slow),
        pytest.param("bare-field", 4, marks=pytest.mark.slow),
        pytest.param("field", 4, marks=pytest.mark.slow),
    ],
)
def test_rest_on_open_ground_is_rest_although_the_lidar_alone_slides(name, seed):
    simulation, packets, imu = packets_and_imu(SCENARIOS[name].thinned(duration=1.3), seed)
    first = look(packets, imu, simulation.rig, CONFIG, threads=1)
    assert first.still
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1, first=first)
    assert start.account.kind == "static"
    assert start.events == ()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_motion_that_the_lidar_sees_wins_over_rest_and_rest_over_a_slide(seed):
    for name, walk, moves in (
        ("start-constant", {"speed": 0.15, "begin": 60.0, "duration": 1.3}, True),
        ("start-turning", {"speed": 0.08, "begin": 160.0, "duration": 1.3}, True),
        ("tunnel", {"speed": 5.0, "begin": 8.0, "duration": 1.3}, False),  # blind along its way: nobody can tell
        ("room", {"begin": 0.0, "duration": 1.3}, False),
    ):
        scenario = SCENARIOS[name].thinned(beams=16, columns=256).varied(walk=walk, gait=NO_GAIT)
        simulation, packets, _ = packets_and_imu(scenario, seed)
        _, results = lidar_only(packets, simulation.rig, CONFIG, 1)
        assert rest_explains(scans_of(packets), results, CONFIG) is not moves


def test_rest_that_is_found_best_among_tried_speeds_keeps_what_its_own_scans_saw(monkeypatch):
    """Speeds are tried on five scans, whatever the number that the start has."""
    from heliograph.odometry.filter import opening

    scenario = SCENARIOS["room"].thinned(beams=16, columns=128).varied(walk={"begin": 0.0, "duration": 1.1})
    simulation, packets, _ = packets_and_imu(scenario, 1)
    config = replace(CONFIG, filter=replace(CONFIG.filter, tried_speeds=(300.0,)))  # at which nothing matches
    plain, results = lidar_only(packets, simulation.rig, config, 1)
    assert len(results) > 5
    monkeypatch.setattr(opening, "_blind_direction", lambda *_: np.array([1.0, 0.0, 0.0]))
    tried, again = lidar_only(packets, simulation.rig, config, 1)
    assert len(again) == len(results)
    np.testing.assert_array_equal(tried.unseen_imu, plain.unseen_imu)


def test_a_speed_that_no_scan_sees_stays_unknown():
    """In a tunnel whose niches are rare the scans slide: their poses say nothing of the speed along it."""
    scenario = SCENARIOS["tunnel"].thinned(beams=16, columns=180).varied(lidar={"max_range": 15.0})
    simulation, packets, imu = packets_and_imu(scenario.varied(walk={"speed": 1.5, "begin": 8.0, "duration": 3.3}))
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1)
    truth = simulation.truth.motion(np.array([start.state.stamp_ns]))
    assert (start.account.kind, start.account.verdict) == ("moving", "poor")
    assert [event.severity for event in start.events] == ["warning"]
    axis = (start.state.R_odom_imu @ truth.R_world_body[0].T)[:, 0]
    P = start.state.covariance[VELOCITY, VELOCITY]
    sigma, error = np.sqrt(axis @ P @ axis), start.state.v_odom @ axis - truth.v_world[0, 0]
    assert 1.0 < sigma < 2.0 * CONFIG.filter.unknown_speed + 1.0
    assert abs(error) < 3.0 * sigma
    across = np.linalg.svd(axis[None])[2][1:]
    assert np.sqrt(np.linalg.eigvalsh(across @ P @ across.T)[-1]) < 0.7  # the rest is seen


def test_start_without_imu_warns_and_knows_no_gravity():
    start, truth = start_in({"begin": 8.0, "duration": 1.3}, NO_GAIT, sensors_imu=False)
    (event,) = start.events
    assert event.code == "no-imu"
    assert not start.motion.inertial
    np.testing.assert_array_equal(start.state.g_odom, 0.0)
    v_imu, v_true = start.state.R_odom_imu.T @ start.state.v_odom, truth.R_world_body[0].T @ truth.v_world[0]
    np.testing.assert_allclose(v_imu, v_true, atol=0.15)


def test_start_in_motion_names_what_it_found_and_leaves_the_tilt_to_the_bias():
    start, truth = start_in({"begin": 9.0, "duration": 1.8}, NO_GAIT)
    account, state = start.account, start.state
    assert (account.kind, account.verdict) == ("moving", "fair")
    assert account.unobservable == ("accelerometer bias x", "accelerometer bias y")
    assert account.gravity_sigma == pytest.approx(CONFIG.imu.accel_bias_sigma / GRAVITY, rel=0.1)
    assert account.velocity_sigma < 0.1
    assert account.accel_scale == pytest.approx(1.0, abs=4.0 * account.accel_scale_sigma)
    assert account.turned < np.radians(2.0)
    sigma = np.sqrt(np.diag(state.covariance))
    assert np.abs(state.covariance[12:15, 15:17] / np.outer(sigma[12:15], sigma[15:17])).max() > 0.8
    np.testing.assert_array_equal(state.covariance[:6], 0.0)
    v_imu, v_true = state.R_odom_imu.T @ state.v_odom, truth.R_world_body[0].T @ truth.v_world[0]
    np.testing.assert_allclose(v_imu, v_true, atol=0.05)


def test_the_rough_start_remains_where_nothing_can_be_aligned():
    """A gyroscope with swapped axes contradicts the LiDAR: no alignment, and the account says so."""
    scenario = SCENARIOS["start-shaking"].thinned(beams=16, columns=128).varied(walk={"duration": 1.2})
    simulation, packets, imu = packets_and_imu(scenario)
    swapped = replace(imu, gyro=imu.gyro[:, [1, 0, 2]])
    start = find_start(packets, swapped, simulation.rig, CONFIG, threads=1)
    (event,) = start.events
    assert start.account.verdict == "poor"
    assert any(why in start.account.reason for why in ("contradict", "settled", "matched"))
    assert (event.code, event.severity) == ("start-moving", "warning")
    assert "2 s at rest" in event.message
    assert np.sqrt(start.state.covariance[6, 6]) > 0.2


def test_unknown_mounting_keeps_a_wide_start():
    scenario = SCENARIOS["start-turning"].thinned(beams=16, columns=128).varied(walk={"duration": 1.2})
    simulation, packets, imu = packets_and_imu(scenario)
    guess = replace(simulation.rig, known=False, sigma_rotation=0.05, sigma_translation=0.1)
    sure, unsure = (find_start(packets, imu, rig, CONFIG, threads=1).state for rig in (simulation.rig, guess))
    assert np.sqrt(sure.covariance[6, 6]) < 0.2
    assert np.sqrt(unsure.covariance[6, 6]) == pytest.approx(0.3)
    np.testing.assert_allclose(np.diag(unsure.covariance)[17:], [2.5e-3] * 3 + [1e-2] * 3)
    np.testing.assert_allclose(unsure.v_odom, sure.v_odom, atol=1e-9)


def test_vibration_at_rest_needs_the_lidar_to_agree():
    still, _ = shaken_start({"duration": 1.3})
    assert still.account.kind == "static"
    assert still.account.verdict == "fair"
    assert "vibrating" in still.account.reason
    assert np.linalg.norm(still.state.v_odom) == 0.0
    driving, truth = shaken_start({"begin": 9.0, "duration": 1.3})
    assert driving.account.kind == "moving"
    v = driving.state.R_odom_imu.T @ driving.state.v_odom
    np.testing.assert_allclose(v, truth.R_world_body[0].T @ truth.v_world[0], atol=0.15)


@pytest.mark.parametrize("speed", [25.0, pytest.param(33.0, marks=pytest.mark.slow)])
def test_a_car_on_a_smooth_road_is_not_taken_for_resting(speed):
    walk = {"speed": speed, "begin": 7.2, "duration": 1.3}
    scenario = SCENARIOS["start-vehicle"].thinned(beams=32, columns=256).varied(walk=walk)
    simulation, packets, imu = packets_and_imu(scenario, seed=4)
    first = look(packets, imu, simulation.rig, CONFIG, threads=1)
    assert first.rest.still
    assert not first.still
    np.testing.assert_allclose(first.moved.v_imu, [speed, 0.0, 0.0], atol=0.3)


def test_a_slow_steady_turn_is_not_taken_for_a_bias():
    walk = {"speed": 0.08, "begin": 160.0, "duration": 1.3}
    scenario = SCENARIOS["start-turning"].thinned(beams=16, columns=256).varied(walk=walk)
    simulation, packets, imu = packets_and_imu(scenario)
    first = look(packets, imu, simulation.rig, CONFIG, threads=1)
    assert first.rest.still
    assert not first.rest.doubtful
    assert first.moved.speed < CONFIG.imu.still_speed
    assert not first.still
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1, first=first)
    assert "turns at 0.04" in start.events[0].message
    bias = simulation.imu_errors.gyro_bias[0]
    np.testing.assert_allclose(start.state.gyro_bias, bias, atol=5e-3)  # the turn is 0.044 rad/s


def test_a_very_large_bias_at_rest_needs_the_lidar_to_agree(rng):
    poor = {"gyro_bias": 0.12, "accel_bias": 0.4}
    scenario = SCENARIOS["start-turning"].thinned(beams=16, columns=128).varied(imu=poor)
    simulation, packets, imu = packets_and_imu(scenario.varied(walk={"begin": 0.0, "duration": 1.3}), seed=2)
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1)
    assert start.account.kind == "static"
    assert "very large bias" in start.account.reason
    assert np.linalg.norm(start.state.v_odom) == 0.0
    np.testing.assert_allclose(start.state.gyro_bias, simulation.imu_errors.gyro_bias[0], atol=1e-3)
    blind = find_start([replace(packet, scan=None) for packet in packets], imu, simulation.rig, CONFIG, threads=1)
    assert blind.account.kind == "moving"


def shaken_start(walk):
    """A start on a smooth course with an engine's vibration on the IMU."""
    scenario = SCENARIOS["warehouse"].thinned(beams=16, columns=128).varied(walk=walk, gait=NO_GAIT)
    simulation, packets, imu = packets_and_imu(scenario)
    t = (imu.stamps_ns - imu.stamps_ns[0])[:, None] * 1e-9
    wave = np.sin(2.0 * np.pi * 27.0 * t + np.arange(6.0))
    imu = replace(imu, gyro=imu.gyro + 0.05 * wave[:, :3], accel=imu.accel + 1.5 * wave[:, 3:])
    start = find_start(packets, imu, simulation.rig, CONFIG, threads=1)
    return start, simulation.truth.motion(np.array([start.state.stamp_ns]))


def test_vibration_without_a_lidar_counts_as_motion(rng):
    imu = resting_imu(rng, up=np.array([0.0, 0.0, 1.0]), gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
    t = (imu.stamps_ns - imu.stamps_ns[0])[:, None] * 1e-9
    start = start_of(replace(imu, accel=imu.accel + np.sin(2.0 * np.pi * 27.0 * t)))
    assert start.account.kind == "moving"


def anchored_errors(seed):
    """Error and covariance (11, 11) of an aligned start: velocity, biases, gravity, seen from its exact first pose."""
    trial = Trial(seed)
    state = _aligned_state(trial.found, Rig(T_imu_lidar=trial.T_imu_lidar, source="test"), EXACT)
    R = state.R_odom_imu @ trial.R.T
    truth = replace(
        state,
        v_odom=R @ trial.v,
        gyro_bias=state.gyro_bias + trial.error[9:12],
        accel_bias=state.accel_bias + trial.error[12:15],
        g_odom=-GRAVITY * state.R_odom_imu @ trial.up_imu,
    )
    return local(state, truth)[6:17], state.covariance[6:17, 6:17]


def test_attaching_the_frame_to_the_first_pose_keeps_the_covariance_honest(monkeypatch):
    """With all that the scans said told, squared errors average to their number; with a quarter they stay below."""
    means = {}
    for share in (1.0, 0.25):
        monkeypatch.setattr("heliograph.odometry.filter.start._INFORMATION_SHARE", share)
        pairs = [anchored_errors(seed) for seed in range(40)]
        means[share] = np.mean([error @ np.linalg.solve(P, error) for error, P in pairs])
    low, high = chi2.ppf([0.0005, 0.9995], 11 * 40) / 40
    assert low < means[1.0] < high
    assert means[0.25] < 0.8 * means[1.0]


def test_a_rotation_that_is_uncertain_goes_over_to_velocity_and_gravity(monkeypatch):
    """Eq. (12) against draws: errors of the alignment, seen from where its true first pose is the state's."""
    monkeypatch.setattr("heliograph.odometry.filter.start._INFORMATION_SHARE", 1.0)
    rng, trial = np.random.default_rng(5), Trial(1)
    root = np.diag(np.repeat([0.02, 0.01, 0.03, 1e-3, 0.02, 0.02], [3, 3, 3, 3, 3, 2])) @ rng.normal(size=(17, 17))
    prior = np.repeat([EXACT.imu.gyro_bias_sigma**-2, EXACT.imu.accel_bias_sigma**-2], 3)
    information = np.zeros((18, 18))
    information[:17, :17] = np.linalg.inv(root @ root.T / 17.0)
    covariance = np.linalg.inv(information[:17, :17] + np.diag(np.r_[np.zeros(9), prior, np.zeros(2)]))
    found = replace(trial.found, information=information)
    state = _aligned_state(found, Rig(T_imu_lidar=np.eye(4), source="test"), EXACT)
    errors = []
    for e in rng.multivariate_normal(np.zeros(17), covariance, size=4000):
        R = state.R_odom_imu @ (found.R_odom_imu[0] @ so3.exp(e[:3])).T
        g = R @ (GRAVITY * s2.retract(found.g_odom / GRAVITY, e[15:17]))
        truth = replace(state, v_odom=R @ (found.v_odom[0] + e[6:9]), g_odom=g)
        truth = replace(truth, gyro_bias=found.gyro_bias + e[9:12], accel_bias=found.accel_bias + e[12:15])
        errors.append(local(state, truth)[6:17])
    whitened = np.linalg.solve(np.linalg.cholesky(state.covariance[6:17, 6:17]), np.array(errors).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(11), atol=0.15)
