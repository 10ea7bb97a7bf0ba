"""Whole runs over places that repeat themselves: every loop that stands is right, and the map is no worse for it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.lie import interpolate_se3, se3
from heliograph.metrics.trajectory import Association, absolute_trajectory_error
from heliograph.output import FinalPoses, Sink
from heliograph.pipeline import run
from heliograph.sim import SCENARIOS, Simulation
from heliograph.slam import KeyframeStore
from heliograph.slam.loops.ledger_file import read_ledger

SCENES = {
    "storeys": SCENARIOS["storeys"].thinned(beams=24, columns=360),
    "campus": SCENARIOS["campus"].thinned(beams=24, columns=360),
}


class Poses(Sink):
    """Keeps the odometry's poses at the scans' ends, and the summary."""

    def __init__(self):
        self.stamps, self.poses, self.summary = [], [], None

    def add(self, result):
        self.stamps.append(result.end_ns)
        self.poses.append(result.T_odom_imu)

    def close(self, summary):
        self.summary = summary


def errors_of_loops(folder, truth):
    """Return how far each accepted loop is off in metres and degrees."""
    store, ledger = KeyframeStore.open(folder / "keyframes"), read_ledger(folder / "loops.csv")
    T = truth(np.array([keyframe.stamp_ns for keyframe in store]))
    off = [
        se3.local(se3.inverse(T[e.evidence.match]) @ T[e.evidence.query], e.evidence.T_match_query)
        for e in ledger.accepted()
    ]
    return np.array([[np.linalg.norm(d[3:]), np.degrees(np.linalg.norm(d[:3]))] for d in off]).reshape(-1, 2)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [21, 22])
@pytest.mark.parametrize("name", SCENES)
def test_loops_are_right_and_make_the_trajectory_no_worse(tmp_path, name, seed):
    simulation = Simulation(SCENES[name], seed)
    config = RunConfig(threads=1)
    # So far away from the past that the odometry's own map has forgotten it.
    config = replace(config, map=replace(config.map, radius=60.0))
    sink = Poses()
    run(Simulated(simulation), config, sinks=[sink], folder=tmp_path)
    errors = errors_of_loops(tmp_path, simulation.truth.pose)
    assert len(errors) > 3
    assert errors[:, 0].max() < 0.5 and errors[:, 1].max() < 5.0  # none between different places
    assert np.median(errors[:, 0]) < 0.03
    stamps = np.array(sink.stamps)
    T_true, T_odom = simulation.truth.pose(stamps), np.stack(sink.poses)
    before, after = ate(T_odom, T_true), ate(sink.summary.final.T_map_odom(stamps) @ T_odom, T_true)
    assert after < max(0.03, 1.05 * before)


class Simulated:
    """A simulation as a source."""

    repeatable, events, sensors = True, (), frozenset({"lidar", "imu"})

    def __init__(self, simulation):
        self._simulation, self.rig = simulation, simulation.rig

    def stream(self):
        return iter(self._simulation)

    def close(self):
        pass


def ate(T, T_true):
    pair = Association(stamps_ns=np.arange(len(T)), T_estimate=T, T_reference=T_true, distance=np.arange(len(T)))
    return absolute_trajectory_error(pair).rmse


def test_final_poses_bend_without_a_kink():
    """The correction between keyframes changes by no more a scan than a share of what the keyframes' do."""
    stamps = np.arange(0, 11, dtype=np.int64) * 10**9
    T_odom = np.stack([se3.exp(np.array([0.0, 0.0, 0.1 * k, 1.0 * k, 0.0, 0.0])) for k in range(11)])
    bent = np.stack([T @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.02 * k, 0.0])) for k, T in enumerate(T_odom)])
    final = FinalPoses(stamps_ns=stamps, T_odom_imu=T_odom, T_map_imu=bent)
    scans = np.arange(0, 10 * 10**9, 10**8, dtype=np.int64)
    T = final.T_map_odom(scans) @ np.asarray(interpolate_se3(stamps, T_odom, scans))
    steps = se3.local(T[:-1], T[1:])
    assert np.abs(np.diff(steps, axis=0)).max() < 0.005
