"""Recordings that begin in motion against the same course begun at rest, from the first scan on."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_odometry import BOTH, aligned, ate, poses, run, truth_of

from heliograph.cli.main import main
from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.io.files.tum import read_tum
from heliograph.lie import s2
from heliograph.metrics import evaluate
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.scenario import to_toml

STARTS = ["start-constant", "start-turning", "start-shaking", "start-vehicle"]
WHIRL = {"frequency": 2.0, "yaw_deg": 73.0, "roll_deg": 10.0, "pitch_deg": 8.0}
JUMP = {"frequency": 1.05, "bounce": 0.27}
POOR_IMU = {"gyro_bias": 0.05, "accel_bias": 0.3}
HARD = {
    "whirl": SCENARIOS["start-shaking"].varied(gait=WHIRL, walk={"duration": 8.0}),
    "jump": SCENARIOS["start-constant"].varied(gait=JUMP, walk={"duration": 8.0}),
    "highway": SCENARIOS["start-vehicle"].varied(walk={"speed": 25.0, "begin": 7.5, "duration": 6.5}),
    "biased constant": SCENARIOS["start-constant"].varied(imu=POOR_IMU),
    "biased shaking": SCENARIOS["start-shaking"].varied(imu=POOR_IMU),
}


def from_rest(scenario):
    """The same course with the rest that goes before it."""
    return scenario.varied(walk={"begin": 0.0, "duration": scenario.walk.begin + scenario.walk.duration})


def on_the_way(scenario, results, simulation):
    """The results of a static start from the instant on at which the moving recording begins."""
    begin_ns = int(simulation.imu_stamps_ns[0] + 1e9 * scenario.walk.begin)
    return [result for result in results if result.stamp_ns >= begin_ns]


def first_second(simulation, results):
    """Largest error of the first ten poses when the whole is aligned [m]."""
    truth = truth_of(simulation, results)
    return float(np.linalg.norm((aligned(poses(results), truth) - truth)[:10, :3, 3], axis=1).max())


def compared(scenario, seed):
    """ATE of a moving start and of the static one over the same way, and the moving start's first second [m]."""
    moving, static = simulate(scenario, seed), simulate(from_rest(scenario), seed)
    results, odometry = run(moving, moving.rig)
    assert len(results) == moving.sweep_count()
    assert all(result.status == "tracked" for result in results[1:])
    assert odometry.start.kind == "moving"
    assert odometry.start.verdict in ("good", "fair")
    rested, other = run(static, static.rig)
    assert other.start.kind == "static"
    return ate(moving, results), ate(static, on_the_way(scenario, rested, static)), first_second(moving, results)


@pytest.mark.parametrize("name", ["start-turning", "start-shaking"])
def test_motion_from_the_first_scan_is_tracked_like_from_rest(name):
    scenario = SCENARIOS[name].thinned(beams=16, columns=256, duration=5.0)
    moving, static, first = compared(scenario, 1)
    assert moving < 2.0 * static
    assert first < 0.01


def test_a_moving_start_waits_for_three_seconds_and_then_gives_every_scan():
    scenario = SCENARIOS["start-shaking"].thinned(beams=12, columns=128, duration=3.6)
    simulation = simulate(scenario, 2)
    odometry, counts, ready = make_odometry(RunConfig(), simulation.rig, BOTH, 1), [], None
    for record in simulation:
        found = odometry.add(record)
        counts.append(len(found))
        if found and ready is None:
            ready = (record.received_ns - int(simulation.imu_stamps_ns[0])) * 1e-9
    odometry.finish()
    assert ready == pytest.approx(RunConfig().imu.moving_window, abs=0.25)
    assert max(counts) >= 28
    first = odometry.start
    assert first.turned > 0.1
    assert np.isfinite(first.accel_scale_sigma)


def test_a_moving_start_is_the_same_bits_on_two_threads_and_with_later_messages_in_other_batches():
    scenario = SCENARIOS["start-shaking"].thinned(beams=12, columns=128, duration=3.6)
    simulation = simulate(scenario, 3)
    records = list(simulation)
    one, two = (run(records, simulation.rig, threads=threads)[0] for threads in (1, 2))
    np.testing.assert_array_equal(poses(one), poses(two))
    np.testing.assert_array_equal(one[-1].covariance, two[-1].covariance)


def test_a_recording_shorter_than_the_window_still_starts():
    scenario = SCENARIOS["start-turning"].thinned(beams=16, columns=128, duration=1.5)
    simulation = simulate(scenario, 1)
    results, odometry = run(simulation, simulation.rig)
    assert len(results) == sum(isinstance(record, Scan) for record in simulation)
    assert odometry.start.duration < 1.6
    assert ate(simulation, results) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", STARTS)
def test_command_line_tracks_a_moving_start_within_twice_the_static_one(name, seed, tmp_path, capsys):
    scenario = SCENARIOS[name]
    errors = {}
    for kind, variant in (("moving", scenario), ("static", from_rest(scenario))):
        told = tmp_path / f"{kind}.toml"
        told.write_text(to_toml(replace(variant, name=kind)))
        recording, out = tmp_path / kind, tmp_path / f"{kind}_run"
        assert main(["simulate", str(told), "-o", str(recording), "--seed", str(seed), "--quiet"]) == 0
        capsys.readouterr()
        assert main(["run", str(recording), "-o", str(out), "--json", "--threads", "1"]) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts["status"] == "ok"
        assert facts["start"]["kind"] == kind
        estimate, truth = read_tum(out / "trajectory.tum"), read_tum(recording / "groundtruth_imu.tum")
        if kind == "moving":
            assert facts["start"]["verdict"] in ("good", "fair")
            assert facts["scan_verdicts"] == {"first": 1, "tracked": len(estimate) - 1}
        else:
            way = estimate.stamps_ns >= truth.stamps_ns[0] + int(1e9 * scenario.walk.begin)
            estimate = replace(estimate, stamps_ns=estimate.stamps_ns[way], T_frame_body=estimate.T_frame_body[way])
        errors[kind] = evaluate(estimate, truth).absolute.rmse
    assert errors["moving"] <= 2.0 * errors["static"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", HARD)
def test_hard_starts_are_tracked_from_the_first_second(name, seed):
    moving, static, first = compared(HARD[name], seed)
    assert moving <= 2.0 * static
    assert first < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", STARTS)
def test_what_a_moving_start_claims_covers_its_errors(name):
    """The LiDAR's poses share their map's errors, so no chi-square: bounds on the mean squared error in its sigmas."""
    squares = []
    for seed in range(1, 7):
        simulation = simulate(SCENARIOS[name].thinned(duration=3.4), seed)
        results, odometry = run(simulation, simulation.rig)
        first, truth = results[0], simulation.truth.motion(np.array([results[0].end_ns]))
        back, back_true = first.T_odom_imu[:3, :3].T, np.swapaxes(truth.R_world_body, -1, -2)[0]
        v = back @ first.v_odom - back_true @ truth.v_world[0]
        tilt = s2.local(back @ first.g_odom / 9.80665, back_true @ [0.0, 0.0, -1.0])
        start = odometry.start
        bias = first.gyro_bias - simulation.imu_errors.gyro_bias[0]
        squares.append([
            v @ v / (3.0 * start.velocity_sigma**2),
            tilt @ tilt / (2.0 * start.gravity_sigma**2),
            np.mean((bias / start.gyro_bias_sigma) ** 2),
        ])  # fmt: skip
    assert (np.mean(squares, axis=0) < 2.0).all()
    assert np.mean(squares, axis=0)[1] > 0.02  # not by orders of magnitude
