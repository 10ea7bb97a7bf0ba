"""A recording's inertial data, examined: its raw samples and how its LiDAR alone saw it move -> findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from heliograph.checks import CheckedMotion, CheckReport, check_imu
from heliograph.config import RunConfig
from heliograph.data import Scan, ScanResult, Source, Trajectory
from heliograph.errors import DataError
from heliograph.io import Recording
from heliograph.lie import so3
from heliograph.odometry.follow import follow_lidar

__all__ = ["Watcher", "examine_imu", "lidar_motion"]

Watcher = Callable[[str, int], None]
"""Told what is being read and how much of it is done."""

MAX_SECONDS = 60.0
"""LiDAR data that are compared with the IMU; more tells little more [s]."""
_THINNING_STEP = 3  # every third point is used: the motion shows in few
_MIN_SCANS = 20
# What the reader inferred and said about the IMU; what the findings say anew is left out.
_INERTIAL = ("imu topic", "imu rate", "accelerometer unit", "gyroscope unit", "mounting")
_INERTIAL_EVENTS = (
    "imu-topics",
    "clock-mismatch",
    "unknown-mount",
    "moving-mount",
    "truncated",
    "imu-bad-rows",
    "imu-columns",
)


def examine_imu(
    recording: Recording,
    config: RunConfig,
    *,
    threads: int = 1,
    seconds: float = MAX_SECONDS,
    why: str = "",
    watch: Watcher = lambda _what, _done: None,
) -> CheckReport:
    """Check a recording's inertial data.

    Parameters
    ----------
    recording : Recording
        Open; its IMU is read once through, its LiDAR for the first ``seconds``.
    config : RunConfig
        Configuration of the LiDAR odometry.
    threads : int
        Threads of the native loops; the findings do not depend on it.
    seconds : float
        How much of the LiDAR to compare with [s].
    why : str
        Why the recording was opened without its LiDAR, if it was.
    watch : callable
        See `Watcher`.

    Returns
    -------
    CheckReport
        Checks that need a LiDAR are ``unknown`` where it is missing or cannot be followed.

    Raises
    ------
    DataError
        The recording holds no IMU.
    """
    if "imu" not in recording.sensors:
        raise DataError(f"{recording.description} holds no IMU to check; `heliograph info` lists its topics")
    imu = recording.imu_record(watch)
    motion, unseen = lidar_motion(recording, config, threads=threads, seconds=seconds, watch=watch)
    rig = recording.rig
    facts: dict[str, object] = {
        "samples": len(imu),
        "imu_topic": imu.topic,
        "scans": 0 if motion is None else len(motion),
        "lidar_seconds": 0.0 if motion is None else float(np.ptp(motion.trajectory.stamps_ns)) * 1e-9,
        "mounting": {"source": rig.source, "known": rig.known},
        "inferences": [
            {"name": i.name, "value": i.value, "evidence": i.evidence, "source": i.source}
            for i in recording.inferences
            if i.name in _INERTIAL
        ],
        "events": [asdict(event) for event in recording.events if event.code in _INERTIAL_EVENTS],
    }
    return CheckReport(
        recording=recording.description,
        findings=check_imu(imu, motion, why or unseen, config=config.check),
        facts=facts,
    )


def lidar_motion(
    recording: Source,
    config: RunConfig,
    *,
    threads: int = 1,
    seconds: float = MAX_SECONDS,
    watch: Watcher = lambda _what, _done: None,
) -> tuple[CheckedMotion | None, str]:
    """Follow the LiDAR alone over the first part of a recording.

    Returns
    -------
    motion : CheckedMotion or None
        None where it cannot be followed.
    why : str
        The reason for that; empty otherwise.
    """
    if "lidar" not in recording.sensors:
        return None, "the recording holds no LiDAR"
    results = []
    with closing(recording.stream()) as stream:  # type: ignore[type-var]
        for result in follow_lidar(_first_scans(stream, seconds), config, threads=threads):
            results.append(result)
            watch("scans", len(results))
    if len(results) < _MIN_SCANS:
        return None, f"only {len(results)} of the {_MIN_SCANS} scans that are needed can be followed"
    tracked = np.array([result.matched for result in results])
    if np.count_nonzero(tracked) < max(_MIN_SCANS, len(results) // 2):
        return None, f"only {np.count_nonzero(tracked)} of {len(results)} scans could be matched without an IMU"
    stamps_ns, T_odom_lidar = _at_middle(results)
    forward = np.concatenate([[True], np.diff(stamps_ns) > 0])
    trajectory = Trajectory(stamps_ns=stamps_ns[forward], T_frame_body=T_odom_lidar[forward], body="lidar")
    sweep = float(np.median([result.end_ns - result.stamp_ns for result in results])) * 1e-9
    return CheckedMotion(trajectory=trajectory, tracked=tracked[forward], rig=recording.rig, sweep=sweep), ""


def _at_middle(results: Sequence[ScanResult]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return stamps and T_odom_lidar at the sweeps' middles: what the points as a whole measure.

    At the sweep's end, to which the odometry refers, the pose leans on the velocity half a sweep further, and without
    an IMU that is the last scans'. The "gyroscope bias" of its constant-velocity model is minus the body rate.
    """
    back_ns = np.array([(result.end_ns - result.stamp_ns) // 2 for result in results], dtype=np.int64)
    back = back_ns * 1e-9
    T = np.stack([result.T_odom_imu for result in results])
    T[:, :3, 3] -= back[:, None] * np.stack([result.v_odom for result in results])
    T[:, :3, :3] = T[:, :3, :3] @ so3.exp(back[:, None] * np.stack([result.gyro_bias for result in results]))
    return np.array([result.end_ns for result in results], dtype=np.int64) - back_ns, T


def _first_scans(stream: Iterable[object], seconds: float) -> Iterator[Scan]:
    """Yield the thinned scans of a stream, up to the first that begins more than ``seconds`` after the first."""
    first_ns: int | None = None
    for message in stream:
        if not isinstance(message, Scan):
            continue
        first_ns = message.stamp_ns if first_ns is None else first_ns
        yield message.thinned(_THINNING_STEP)
        if (message.stamp_ns - first_ns) * 1e-9 > seconds:
            return
