"""KISS-ICP: LiDAR only, constant-velocity de-skewing. Reports the LiDAR frame; full precision is in its .npy file."""

from __future__ import annotations

import numpy as np

from benchmarks.rivals.adapter import Adapter, Job, trajectory_of
from heliograph.data import Trajectory


def command_of(program: str, job: Job) -> list[str]:
    """Return the command line that KISS-ICP and the systems built on it share."""
    return [str(job.bin / program), "--topic", job.lidar_topic, str(job.recording)]


def trajectory_in(job: Job) -> Trajectory:
    """Read stamps from the TUM file, poses (which that file rounds to 4 digits) from the .npy beside it."""
    (folder,) = [d for d in job.out.iterdir() if d.is_dir() and not d.is_symlink()]
    (stamps,) = folder.glob("*_tum.txt")
    (poses,) = folder.glob("*_poses.npy")
    return trajectory_of(np.loadtxt(stamps)[:, 0], np.load(poses), "lidar")


ADAPTER = Adapter(
    name="kiss-icp",
    package="kiss-icp",
    sensors="LiDAR",
    body="lidar",
    command=lambda job: command_of("kiss_icp_pipeline", job),
    environment=lambda job: {"kiss_icp_out_dir": str(job.out)},
    trajectory=trajectory_in,
)
