"""Heliograph: `heliograph run RECORDING -o OUT`, no options but the output folder and the progress switched off."""

from __future__ import annotations

from benchmarks.rivals.adapter import Adapter, Job
from heliograph.data import Trajectory
from heliograph.io import read_tum


def _command(job: Job) -> list[str]:
    threads = ["--threads", str(job.cores)] if job.cores else []
    program = str(job.bin / "heliograph")
    return [program, "run", str(job.recording), "-o", str(job.out / "run"), "--overwrite", "--quiet", *threads]


def _trajectory(job: Job) -> Trajectory:
    return read_tum(job.out / "run" / "trajectory.tum")


ADAPTER = Adapter(
    name="heliograph",
    package="heliograph",
    sensors="LiDAR + IMU",
    body="imu",
    command=_command,
    trajectory=_trajectory,
)
