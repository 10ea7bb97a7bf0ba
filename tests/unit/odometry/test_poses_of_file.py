"""Poses of another system: looked up by stamp, interpolated within reason, honest about what they may have drifted."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import RunConfig
from heliograph.data import Scan, Trajectory
from heliograph.errors import DataError, FormatError
from heliograph.io.files.poses import is_pose_file, read_poses
from heliograph.lie import se3
from heliograph.odometry import PoseFileOdometry
from heliograph.testing import assert_odometry

NS = 10**9


def scan(seconds, points=50):
    stamp = round(seconds * NS)
    rng = np.random.default_rng(3)
    return Scan(
        stamp_ns=stamp, header_stamp_ns=stamp, received_ns=stamp, end_ns=stamp,
        points=rng.normal(size=(points, 3)).astype(np.float32), offsets_ns=np.zeros(points, np.int32),
        intensity=None, ring=None, has_point_times=False,
    )  # fmt: skip


def trajectory(seconds):
    stamps = np.array([round(s * NS) for s in seconds], dtype=np.int64)
    poses = np.stack([se3.exp(np.array([0.0, 0.0, 0.1 * s, s, 0.0, 0.0])) for s in seconds])
    return Trajectory(stamps_ns=stamps, T_frame_body=poses)


def odometry(seconds, **slam):
    config = RunConfig()
    return PoseFileOdometry(trajectory(seconds), replace(config, slam=replace(config.slam, **slam)), np.eye(4))


def test_scan_gets_its_own_pose_and_one_between_two_is_interpolated():
    given = odometry([1.0, 2.0])
    first, between = given.add(scan(1.0))[0], given.add(scan(1.5))[0]
    np.testing.assert_array_equal(first.T_odom_imu, trajectory([1.0]).T_frame_body[0])
    np.testing.assert_allclose(between.T_odom_imu, trajectory([1.5]).T_frame_body[0], atol=1e-9)
    assert first.status == "first" and between.status == "tracked"


@pytest.mark.parametrize("seconds", [0.5, 2.5, 8.0])
def test_scan_without_a_pose_is_left_out_and_counted(seconds):
    given = odometry([1.0, 2.0, 7.9])  # a gap of six seconds is not bridged
    results = [given.add(scan(s)) for s in sorted([1.5, seconds])]
    assert sum(map(len, results)) == 1
    given.finish()
    (event,) = given.events
    assert event.code == "no-pose" and "left out" in event.message


def test_poses_of_another_time_are_refused():
    given = odometry([1.0, 2.0])
    for seconds in (5.0, 5.1, 5.2):
        given.add(scan(seconds))
    with pytest.raises(DataError, match=r"none of the 3 scans has a pose in the file.*1.000 to 2.000 s.*5.000 s"):
        given.finish()


def test_covariance_grows_with_the_way():
    given = odometry([0.0, 1.0, 2.0, 5.0, 6.0], pose_position_sigma=0.1)
    results = [given.add(scan(s))[0] for s in (0.0, 1.0, 2.0)]
    sigmas = [np.sqrt(np.trace(r.pose_covariance[3:, 3:])) for r in results]
    assert sigmas[0] == 0.0 < sigmas[1] < sigmas[2]
    assert sigmas[1] == pytest.approx(0.1 * np.sqrt(3 * 1.1), rel=0.1)


def test_poses_of_a_file_obey_the_law_of_odometries():
    scans = [scan(0.1 * k) for k in range(30)]
    assert_odometry(lambda: odometry([0.1 * k for k in range(30)]), scans)


def test_empty_trajectory_is_refused():
    nothing = Trajectory(stamps_ns=np.zeros(0, np.int64), T_frame_body=np.zeros((0, 4, 4)))
    with pytest.raises(DataError, match="holds none"):
        PoseFileOdometry(nothing, RunConfig(), np.eye(4))


def test_kitti_rows_take_the_times_beside_them(tmp_path):
    rows = trajectory([0.0, 1.0, 2.0]).T_frame_body[:, :3].reshape(3, 12)
    np.savetxt(tmp_path / "poses.txt", rows)
    with pytest.raises(FormatError, match=r"times.txt"):
        read_poses(tmp_path / "poses.txt", stamped=True)
    (tmp_path / "times.txt").write_text("10.0\n10.5\n11.0\n")
    read = read_poses(tmp_path / "poses.txt", stamped=True)
    np.testing.assert_array_equal(read.stamps_ns, [10 * NS, 10 * NS + NS // 2, 11 * NS])
    np.testing.assert_allclose(read.T_frame_body[:, :3].reshape(3, 12), rows, atol=1e-9)


def test_number_of_times_that_differs_is_one_line(tmp_path):
    np.savetxt(tmp_path / "poses.txt", trajectory([0.0, 1.0]).T_frame_body[:, :3].reshape(2, 12))
    (tmp_path / "times.txt").write_text("10.0\n10.5\n11.0\n")
    with pytest.raises(FormatError, match="2 poses, but there are 3 stamps"):
        read_poses(tmp_path / "poses.txt", stamped=True)


@pytest.mark.parametrize(("name", "file"), [("filter", False), ("loam", False), ("a/b.tum", True), ("poses.txt", True)])
def test_name_of_an_odometry_is_told_from_a_file(name, file):
    assert is_pose_file(name) == file


def test_poses_that_come_slowly_are_a_choice_of_keyframes():
    slow = [0.0, 0.4, 0.5, 1.0, 1.4]  # a quick one among them too
    np.testing.assert_array_equal(odometry(slow).chosen_ns, trajectory(slow).stamps_ns)
    assert len(odometry([0.1 * k for k in range(8)]).chosen_ns) == 0
    assert len(odometry([1.0]).chosen_ns) == 0
