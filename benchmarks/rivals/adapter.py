"""What the harness needs to know about a system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Trajectory

__all__ = ["Adapter", "Job", "trajectory_of"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One run: what goes in, where the result goes, and whose programs to use."""

    recording: Path
    lidar_topic: str
    out: Path
    bin: Path
    cores: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """A system.

    Parameters
    ----------
    name, package, sensors : str
        As printed, the distribution whose version is reported, and what it estimates from.
    body : str
        Frame whose poses it reports, ``"imu"`` or ``"lidar"``; the results hold the error of the other reading, too.
    command : callable
        The command line for a job.
    environment : callable
        Variables that the command wants.
    trajectory : callable
        Reads the job's result as it was written; poses are `T_odom_body`.
    """

    name: str
    package: str
    sensors: str
    body: str
    command: Callable[[Job], list[str]]
    trajectory: Callable[[Job], Trajectory]
    environment: Callable[[Job], dict[str, str]] = lambda _: {}


def trajectory_of(stamps_s: NDArray[np.float64], poses: NDArray[np.float64], body: str) -> Trajectory:
    """Return stamps [s] and (N, 4, 4) poses as a trajectory, repeated stamps left out."""
    stamps_ns = np.round(stamps_s * 1e9).astype(np.int64)
    keep = np.diff(stamps_ns, prepend=stamps_ns[0] - 1) > 0
    return Trajectory(stamps_ns=stamps_ns[keep], T_frame_body=poses[keep], frame="odom", body=body)
