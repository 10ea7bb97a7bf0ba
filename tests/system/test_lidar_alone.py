"""Runs without an IMU: their sigmas hold, and motion that outruns the model of one velocity a sweep is told."""

from functools import cache

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.lie import so3
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, simulate


@cache
def alone(rate, beams=8, columns=128, duration=4.0, seed=3, rest=1.0):
    """Results of a walk through the room, which begins at rest, and errors of rotation and position."""
    scenario = SCENARIOS["room"].thinned(beams=beams, columns=columns)
    scenario = scenario.varied(lidar={"rate": rate}, walk={"rest": rest, "ramp": 1.0, "duration": duration})
    simulation = simulate(scenario, seed)
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar"}), 1)
    results = [r for m in simulation if isinstance(m, Scan) for r in odometry.add(m)] + odometry.finish()
    T, truth = np.stack([r.T_odom_imu for r in results]), simulation.truth.pose(np.array([r.end_ns for r in results]))
    expected = T[0] @ np.linalg.inv(truth[0]) @ truth
    turn = so3.log(np.swapaxes(T[:, :3, :3], 1, 2) @ expected[:, :3, :3])
    return results, np.concatenate([turn, expected[:, :3, 3] - T[:, :3, 3]], axis=1)


def nees(results, error):
    pairs = zip(results[1:], error[1:], strict=True)
    return np.array([e @ np.linalg.solve(r.pose_covariance, e) for r, e in pairs])


def unsteady(results):
    return np.array([any(event.code == "unsteady-sweep" for event in r.events) for r in results])


def test_sigmas_follow_a_motion_that_changes_within_a_sweep():
    """At 4 Hz a gait of 1.9 Hz goes to and fro within a sweep: degrees are lost, and said."""
    results, error = alone(4.0)
    walking = np.array([r.end_ns for r in results]) > results[0].end_ns + 1_500_000_000
    assert np.degrees(np.linalg.norm(error[walking, :3], axis=1)).max() > 1.0  # else there is nothing to tell
    found = nees(results, error)
    assert np.median(found[walking[1:]]) < 6.0
    assert found.max() < 60.0
    assert unsteady(results)[walking].mean() > 0.2
    assert not unsteady(results)[:4].any()  # at rest


@pytest.mark.slow
@pytest.mark.parametrize("rate", [3.0, 5.0, 10.0])
def test_sigmas_of_a_lidar_alone_hold(rate):
    runs = [alone(rate, 16, 256, 20.0, seed, 3.0) for seed in (4, 5, 6)]
    assert np.mean([np.median(nees(*run)) for run in runs]) < 6.0
    assert (np.mean([unsteady(results).mean() for results, _ in runs]) < 0.1) == (rate >= 5.0)
