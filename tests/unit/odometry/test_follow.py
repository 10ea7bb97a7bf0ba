"""The LiDAR alone, followed."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.odometry.follow import follow_lidar, thrifty
from heliograph.sim import SCENARIOS, simulate


@pytest.fixture(scope="module")
def walk():
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=120, duration=3.5), 1)
    return simulation, [record for record in simulation if isinstance(record, Scan)]


def test_follow_lidar_gives_one_pose_of_the_lidar_a_scan(walk):
    simulation, scans = walk
    results = list(follow_lidar(scans, RunConfig(), matches=800))
    assert [result.end_ns for result in results] == [scan.end_ns for scan in scans]
    assert all(result.matched for result in results)
    stamps = np.array([result.end_ns for result in results])
    truth = simulation.truth.pose(stamps) @ simulation.rig.T_imu_lidar
    found = np.stack([result.T_odom_imu for result in results])
    moved = truth[0] @ np.linalg.inv(found[0]) @ found
    assert np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.05
    np.testing.assert_array_equal(results[-1].T_imu_lidar, np.eye(4))


def test_follow_lidar_takes_scans_only_as_results_are_asked_for(walk):
    _, scans = walk
    taken = []

    def counted():
        for scan in scans:
            taken.append(scan)
            yield scan

    followed = follow_lidar(counted(), RunConfig(), matches=400)
    next(followed)
    assert 1 < len(taken) < 15
    followed.close()
    assert len(taken) < 15


def test_follow_lidar_places_scans_of_less_than_the_first_second(walk):
    _, scans = walk
    results = list(follow_lidar(scans[:4], RunConfig(), matches=400))
    assert [result.end_ns for result in results] == [scan.end_ns for scan in scans[:4]]


def test_thrifty_changes_nothing_but_the_points_to_match():
    config = RunConfig()
    assert thrifty(config, 700) == replace(config, cloud=replace(config.cloud, target_points=700))
    assert thrifty(config, 0).cloud.target_points == 1
