"""Sensors, mountings and places that no default was tuned on; nothing is told but what a recording holds."""

import numpy as np
import pytest
from test_odometry import BOTH, LIDAR, ate, gap, rotation_rmse_deg, run

from heliograph import pipeline
from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.io import open_recording
from heliograph.output.sink import Sink
from heliograph.output.summary import Tally, judge
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.write import write_recording

WALK = SCENARIOS["warehouse"].thinned(beams=16, columns=256, duration=9.0).varied(walk={"rest": 2.0})


def verdict(results):
    tally = Tally()
    for result in results:
        tally.add(result)
    blind, budget = tally.blind.all(np.eye(3)), RunConfig().check.max_blind_growth
    return judge(tally.statuses, sensors=BOTH, interrupted=False, blind=blind, budget=budget)[0]


@pytest.mark.parametrize("rate", [50.0, 100.0, 1000.0])
def test_imu_rate_does_not_matter(rate):
    simulation = simulate(WALK.varied(imu={"rate": rate}), 1)
    results, odometry = run(simulation, simulation.rig)
    assert ate(simulation, results) < 0.01
    assert {event.code for event in odometry.events} <= {"tilt-uncertain"}
    assert all(result.events == () for result in results)


@pytest.mark.parametrize(
    "change",
    [
        {"mount": {"lever_arm": (1.0, 1.0)}},
        {"imu": {"gyro_bias": 0.05, "accel_bias": 0.3}},
        {"imu": {"gyro_noise": 2e-3, "accel_noise": 2e-2}},
        {"lidar": {"dropout": 0.3, "range_noise": 0.05}},
        {"walk": {"rest": 0.8}},
        {"walk": {"rest": 2.0, "speed": 4.0}},
    ],
    ids=["long lever arm", "large biases", "cheap imu", "poor lidar", "short rest", "fast"],
)
def test_hard_sensors_and_walks_are_followed(change):
    simulation = simulate(WALK.varied(**change), 1)
    results, _ = run(simulation, simulation.rig)
    assert ate(simulation, results) < 0.03
    assert verdict(results) == "ok"


def test_handheld_in_a_room_is_followed():
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=256, duration=12.0), 1)
    results, _ = run(simulation, simulation.rig)
    assert ate(simulation, results) < 0.02
    assert verdict(results) == "ok"


def test_tunnel_whose_niches_tell_is_followed_within_its_sigma():
    simulation = simulate(
        SCENARIOS["tunnel"].thinned(beams=16, columns=256, duration=30.0).varied(walk={"rest": 2.0}), 1
    )
    results, _ = run(simulation, simulation.rig)
    truth = simulation.truth.pose(np.array([result.end_ns for result in results]))
    T = results[0].T_odom_imu @ np.linalg.inv(truth[0]) @ truth
    error = np.stack([result.T_odom_imu[:3, 3] for result in results]) - T[:, :3, 3]
    sigma = np.sqrt(np.stack([np.diag(result.pose_covariance)[3:] for result in results]))
    assert verdict(results) == "ok" and np.abs(error).max() < 0.04
    assert np.mean(np.abs(error[50:]) < 3.0 * sigma[50:]) > 0.97
    along = results[-1].T_odom_imu[:3, 3] / np.linalg.norm(results[-1].T_odom_imu[:3, 3])
    assert np.median([abs(result.weak_direction @ along) for result in results[100:]]) > 0.99


def test_smooth_tunnel_is_called_degraded_in_metres():
    tunnel = SCENARIOS["long-tunnel"].thinned(beams=16, columns=180, duration=62.0)
    simulation = simulate(tunnel.varied(lidar={"max_range": 50.0}), 3)
    results, _ = run(simulation, simulation.rig)
    assert verdict(results) == "degraded"
    blind = [result for result in results if result.status == "degenerate"]
    assert len(blind) > 100
    truth = simulation.truth.pose(np.array([results[0].end_ns, results[-1].end_ns]))
    T = results[0].T_odom_imu @ np.linalg.inv(truth[0]) @ truth[1]
    error, P = results[-1].T_odom_imu[:3, 3] - T[:3, 3], results[-1].pose_covariance[3:, 3:]
    assert error @ np.linalg.solve(P, error) < 16.3  # chi-square of three, 99.9 %
    assert np.sqrt(np.linalg.eigvalsh(P)[-1]) > 0.1


def test_gap_in_a_lidar_alone_is_no_fault_of_an_imu():
    simulation = simulate(WALK.thinned(duration=5.0), 1)
    scans = [record for record in simulation if isinstance(record, Scan)]
    results, _ = run(scans[:20] + scans[25:], simulation.rig, sensors=LIDAR)
    assert not any(event.code == "imu-held" for result in results for event in result.events)


class Poses(Sink):
    def __init__(self):
        self.results = []

    def observe(self, message):
        pass

    def add(self, result):
        self.results.append(result)

    def close(self, summary):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("imu_rpy_deg", [(0.0, 0.0, 90.0), (0.0, 0.0, 180.0), (180.0, 0.0, 0.0)])
def test_lap_with_a_turned_imu_and_no_tf_is_aligned(imu_rpy_deg, tmp_path):
    scenario = SCENARIOS["warehouse"].varied(mount={"imu_rpy_deg": imu_rpy_deg, "tf_static": False})
    kept = Poses()
    folder = write_recording(tmp_path, scenario, seed=1, compress=False).folder
    with open_recording(folder) as recording:
        summary = pipeline.run(recording, RunConfig(), sinks=[kept])
    assert "mounting-aligned" in {event.code for event in summary.events}
    simulation = simulate(scenario, 1)
    assert ate(simulation, kept.results) <= 0.04
    assert gap(simulation, kept.results) <= 0.04
    assert rotation_rmse_deg(simulation, kept.results) <= 0.3


@pytest.mark.slow
@pytest.mark.parametrize("roll", [45.0, 90.0, 180.0])
def test_lap_with_a_rolled_rig_is_level(roll):
    simulation = simulate(SCENARIOS["warehouse"].varied(mount={"rig_rpy_deg": (roll, 0.0, 0.0)}), 1)
    results, odometry = run(simulation, simulation.rig)
    assert ate(simulation, results) <= 0.02
    truth = simulation.truth.pose(np.array([results[-1].end_ns]))[0]
    up = odometry.leveling()[:3, :3] @ results[-1].T_odom_imu[:3, :3] @ truth[:3, :3].T @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(min(1.0, up[2]))) < 0.2
