"""Silences of the sensors: scans find their place again, where none is sure a new piece begins and is told."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan
from heliograph.odometry import make_odometry
from heliograph.odometry.filter import relocking
from heliograph.odometry.filter.core import FilterCore
from heliograph.sim import SCENARIOS, simulate

BOTH = frozenset({"lidar", "imu"})
ROOM = SCENARIOS["room"].thinned(beams=16, columns=180, duration=7.0)
WALK = replace(ROOM, walk=replace(ROOM.walk, rest=1.0, ramp=0.5))


@pytest.fixture(scope="module")
def walk():
    simulation = simulate(WALK, 1)
    return simulation, list(simulation)


def silenced(records, begin, seconds, kinds=(Scan, ImuBatch)):
    """The records without those of some kinds that came between two times from the first on [s]."""
    first = records[0].received_ns
    return [
        r for r in records if not (isinstance(r, kinds) and begin <= (r.received_ns - first) * 1e-9 < begin + seconds)
    ]


def followed(simulation, records):
    odometry = make_odometry(RunConfig(), simulation.rig, BOTH, 1)
    results = [result for record in records for result in odometry.add(record)]
    return results + odometry.finish()


def errors(simulation, results):
    stamps = np.array([r.header_stamp_ns for r in results])
    truth, found = simulation.truth.pose(stamps), np.stack([r.T_odom_imu_header for r in results])
    moved = truth[5] @ np.linalg.inv(found[5]) @ found
    return np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1)


def codes(results):
    return {event.code for result in results for event in result.events}


@pytest.mark.parametrize("seconds", [1.5, 3.0])
def test_scans_after_a_silence_in_motion_are_placed_where_they_were(walk, seconds):
    simulation, records = walk
    results = followed(simulation, silenced(records, 2.5, seconds))
    assert [r.index for r in results] == list(range(len(results)))
    assert {r.status for r in results[1:]} == {"tracked"}
    # The first scan of those began before the inertial samples came back: half a sweep is guessed.
    assert np.sort(errors(simulation, results))[-2] < 0.03
    assert errors(simulation, results).max() < 0.1
    assert "relocked" in codes(results)


def test_place_that_the_scans_before_contradict_is_refused(walk, monkeypatch):
    simulation, records = walk
    found = relocking.find_place_anywhere
    calls = []

    def shifted(prior, *rest):
        """The second scan is led to a pose that is off by a metre and registered nowhere."""
        fit = found(prior, *rest)
        calls.append(fit is not None)
        if len(calls) == 1 or fit is None:
            return None
        if len(calls) == 2:
            return replace(fit, state=replace(fit.state, p_odom=fit.state.p_odom + np.array([1.0, 0.7, 0.0])))
        return fit

    process, led_back = FilterCore.process, {}

    def watched(core, scan, imu):
        if core.holds_map:
            led_back.setdefault(scan.end_ns, []).append(len(imu))
        return process(core, scan, imu)

    monkeypatch.setattr(relocking, "find_place_anywhere", shifted)
    monkeypatch.setattr(relocking, "_MAX_REACH", 0.1)
    monkeypatch.setattr(FilterCore, "process", watched)
    results = followed(simulation, silenced(records, 2.5, 3.0))
    assert len(calls) >= 3
    # A place that was refused costs none of the samples by which the next one leads back.
    assert max(map(len, led_back.values())) >= 2
    assert all(min(counts) == max(counts) for counts in led_back.values())
    assert {r.status for r in results[1:]} == {"tracked"}
    assert np.sort(errors(simulation, results))[-2] < 0.06


def test_no_sure_place_begins_a_new_piece_with_the_first_scan_after_the_silence(walk, monkeypatch):
    simulation, records = walk
    monkeypatch.setattr(relocking, "find_place_anywhere", lambda *_: None)
    monkeypatch.setattr(relocking, "find_place", lambda *_: None)
    results = followed(simulation, silenced(records, 2.5, 3.0))
    (told,) = [event for result in results for event in result.events if event.code == "new-piece"]
    assert told.severity == "error"
    back = next(k for k in range(1, len(results)) if results[k].stamp_ns - results[k - 1].stamp_ns > 1_000_000_000)
    # The piece is one: its scans fit each other from the second on, wherever it lies.
    assert {r.status for r in results[back + 2 :]} == {"tracked"}
    stamps = np.array([r.header_stamp_ns for r in results[back + 1 :]])
    truth, poses = simulation.truth.pose(stamps), np.stack([r.T_odom_imu_header for r in results[back + 1 :]])
    steps = [np.linalg.inv(T[:-1]) @ T[1:] for T in (truth, poses)]
    assert np.linalg.norm(steps[0][2:, :3, 3] - steps[1][2:, :3, 3], axis=1).max() < 0.05
    sigma = np.sqrt(np.linalg.eigvalsh(results[-1].pose_covariance[3:, 3:])[-1])
    assert sigma > errors(simulation, results)[-1] / 3.0


def test_silence_of_one_sensor_ends_in_the_same_place(walk):
    simulation, records = walk
    results = followed(simulation, silenced(records, 2.5, 2.5, (Scan,)))
    assert {r.status for r in results[1:]} == {"tracked"}
    assert errors(simulation, results).max() < 0.03
