"""An odometry beside a driver: nobody waits, what is dropped is counted, and poses come between scans."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Scan
from heliograph.errors import DataError
from heliograph.odometry import ImuRatePose, LiveOdometry, Odometry, make_odometry, pose_result
from heliograph.sim import SCENARIOS, simulate

BOTH = frozenset({"lidar", "imu"})


@pytest.fixture(scope="module")
def walk():
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=180, duration=5.0), 1)
    return simulation, list(simulation)


def test_results_are_those_of_the_odometry_itself(walk):
    simulation, records = walk
    plain = make_odometry(RunConfig(), simulation.rig, BOTH, 1)
    expected = [r for record in records for r in plain.add(record)] + plain.finish()
    found = []
    with LiveOdometry(
        make_odometry(RunConfig(), simulation.rig, BOTH, 1), on_result=found.append, max_waiting=99
    ) as live:
        for record in records:
            live.add(record)
    assert [r.T_odom_imu.tobytes() for r in found] == [r.T_odom_imu.tobytes() for r in expected]
    assert live.dropped == 0
    assert "scans-dropped" not in {event.code for event in live.events}


class Blocked(Odometry):
    """Processes nothing until it is let, and then all that is left."""

    def __init__(self, *, fails=False):
        self.events, self.seen, self.gate, self.fails = [], [], threading.Event(), fails

    def add(self, message):
        self.gate.wait(10.0)
        if self.fails:
            raise DataError("the odometry's own trouble")
        self.seen.append(message)
        return [pose_result(message, len(self.seen), np.eye(4))] if isinstance(message, Scan) else []


def test_a_driver_never_waits_and_what_is_dropped_is_said(walk):
    _, records = walk
    odometry, results = Blocked(), []
    with LiveOdometry(odometry, on_result=results.append, max_waiting=2) as live:
        for record in records[:300]:
            live.add(record)
        assert live.waiting <= 2
        odometry.gate.set()
    scans = [record for record in records[:300] if isinstance(record, Scan)]
    samples = [record for record in records[:300] if isinstance(record, ImuBatch)]
    kept = [message for message in odometry.seen if isinstance(message, Scan)]
    assert live.dropped == len(scans) - len(kept) > 0
    assert kept[-1] is scans[-1]
    assert [m for m in odometry.seen if isinstance(m, ImuBatch)] == samples
    said = {event.code: event for event in live.events}["scans-dropped"]
    assert said.count == live.dropped
    assert f"{live.dropped} scans were left out because more than 2 waited" in said.message


def test_a_failure_is_raised_by_a_later_call(walk):
    _, records = walk
    odometry = Blocked(fails=True)
    live = LiveOdometry(odometry, on_result=lambda _: None)
    live.add(records[0])
    odometry.gate.set()
    with pytest.raises(DataError, match="own trouble"):
        live.close()


def test_poses_between_scans_follow_the_truth_also_while_the_lidar_is_silent(walk):
    simulation, records = walk
    odometry, pose = make_odometry(RunConfig(), simulation.rig, BOTH, 1), ImuRatePose()
    assert pose.add(ImuBatch.joined([])) is None
    states, last_scan = [], []
    silent_from = records[0].received_ns + 4_500_000_000
    for record in records:
        if isinstance(record, Scan) and record.received_ns > silent_from:
            continue
        for k in range(len(record) if isinstance(record, ImuBatch) else 0):
            if (state := pose.add(record[k : k + 1])) is not None:
                states.append(state)
        for result in odometry.add(record):
            pose.correct(result)
            last_scan.append(result)
    stamps = np.array([state.stamp_ns for state in states])
    assert (np.diff(stamps) >= 0).all()
    assert len(np.unique(stamps)) > 300
    truth = simulation.truth.pose(stamps)
    first = simulation.truth.pose(np.array([last_scan[0].end_ns]))[0] @ np.linalg.inv(last_scan[0].T_odom_imu)
    found = np.stack([first @ state.T_odom_imu for state in states])
    assert np.linalg.norm(found[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.03
    assert stamps[-1] - last_scan[-1].end_ns > 300_000_000
    assert states[-1].covariance[3, 3] > 4.0 * last_scan[-1].pose_covariance[3, 3]


def test_an_offset_of_the_imus_clock_is_followed(walk):
    simulation, records = walk
    odometry = make_odometry(RunConfig(), simulation.rig, BOTH, 1)
    results = [r for record in records for r in odometry.add(record)]
    samples = ImuBatch.joined([record for record in records if isinstance(record, ImuBatch)])
    late = replace(samples, stamps_ns=samples.stamps_ns + 20_000_000)
    config = replace(RunConfig(), filter=replace(RunConfig().filter, estimate_time_offset=True))
    estimating = make_odometry(config, simulation.rig, BOTH, 1)
    found = [r for record in records for r in estimating.add(record)][-1].calibration
    shifted = replace(results[20], calibration=replace(found, imu_offset=0.02, imu_drift=0.0))
    poses = []
    for batch, result in ((samples, results[20]), (late, shifted)):
        pose = ImuRatePose()
        pose.add(batch[batch.stamps_ns < batch.stamps_ns[0] + 4_000_000_000])
        poses.append(pose.correct(result))
    assert poses[0].stamp_ns == poses[1].stamp_ns
    np.testing.assert_allclose(poses[0].T_odom_imu, poses[1].T_odom_imu, atol=1e-9)
