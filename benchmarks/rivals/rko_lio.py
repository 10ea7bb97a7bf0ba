"""RKO-LIO: LiDAR-inertial odometry; takes topics and /tf_static from the bag itself. Reports the LiDAR frame."""

from __future__ import annotations

import numpy as np

from benchmarks.rivals.adapter import Adapter, Job, trajectory_of
from heliograph.data import Trajectory
from heliograph.lie import se3, so3


def _command(job: Job) -> list[str]:
    return [str(job.bin / "rko_lio"), "--log_dir", str(job.out), "--run_name", "run", str(job.recording)]


def _trajectory(job: Job) -> Trajectory:
    (file,) = job.out.glob("run_*/*_tum.txt")
    rows = np.loadtxt(file)
    poses = se3.from_rotation_translation(so3.from_quaternion(rows[:, 4:8]), rows[:, 1:4])
    return trajectory_of(rows[:, 0], poses, "lidar")


ADAPTER = Adapter(
    name="rko-lio",
    package="rko_lio",
    sensors="LiDAR + IMU",
    body="lidar",
    command=_command,
    trajectory=_trajectory,
)
