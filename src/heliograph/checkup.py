"""A recording's inertial data, examined: its raw samples and how its LiDAR alone saw it move -> findings."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.checks import CheckReport, ImuRecord, LidarMotion, check_imu
from heliograph.config import RunConfig
from heliograph.data import Rig, Scan, ScanResult, Trajectory
from heliograph.errors import DataError
from heliograph.io import Recording
from heliograph.lie import so3
from heliograph.odometry import FilterOdometry

__all__ = ["Watcher", "examine_imu", "lidar_motion", "read_imu"]

Watcher = Callable[[str, int], None]
"""Told what is being read and how much of it is done."""

LONGEST = 60.0
"""Seconds of LiDAR data that are compared with the IMU; more tells little more."""
_THINNING = 3  # of the points one of so many is used: the motion shows in few
_ENOUGH_SCANS = 20
# What the reader inferred and said about the IMU; what the findings say anew is left out.
_INERTIAL = ("imu topic", "imu rate", "accelerometer unit", "gyroscope unit", "mounting")
_TOLD = ("imu-topics", "clock-mismatch", "unknown-mount", "moving-mount", "truncated", "imu-bad-rows", "imu-columns")


def examine_imu(
    recording: Recording,
    config: RunConfig,
    *,
    threads: int = 1,
    seconds: float = LONGEST,
    why: str = "",
    watch: Watcher = lambda _what, _done: None,
) -> CheckReport:
    """Check a recording's inertial data.

    Parameters
    ----------
    recording : Recording
        Open; its IMU is read once through, its LiDAR for the first ``seconds``.
    config : RunConfig
        Of the LiDAR odometry.
    threads : int
        Of the native loops; the findings do not depend on it.
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
    imu = read_imu(recording, watch)
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
        "events": [asdict(event) for event in recording.events if event.code in _TOLD],
    }
    return CheckReport(recording=recording.description, findings=check_imu(imu, motion, why or unseen), facts=facts)


def read_imu(recording: Recording, watch: Watcher = lambda _what, _done: None) -> ImuRecord:
    """Return all messages of a recording's IMU, as they were recorded.

    Raises
    ------
    DataError
        None came, although the recording announces some.
    """
    stamps, received, values = array("q"), array("q"), array("d")
    with closing(recording.raw_imu()) as samples:  # type: ignore[type-var]
        for sample in samples:
            stamps.append(sample.stamp_ns)
            received.append(sample.received_ns)
            values.extend((*sample.gyro, *sample.accel))
            if len(stamps) % 1000 == 0:
                watch("IMU samples", len(stamps))
    found, units = recording.interpretation, recording.interpretation.units
    if not stamps or units is None:
        raise DataError(f"{recording.description}: {found.imu} holds no sample; `heliograph info` lists the topics")
    taken = {inference.name: inference.value for inference in units.inferences}
    six = np.frombuffer(values, dtype=np.float64).reshape(-1, 6)
    return ImuRecord(
        stamps_ns=np.array(stamps, dtype=np.int64),
        received_ns=np.array(received, dtype=np.int64),
        gyro=np.ascontiguousarray(six[:, :3]),
        accel=np.ascontiguousarray(six[:, 3:]),
        gyro_unit=taken.get("gyroscope unit", "rad/s"),
        accel_unit=taken.get("accelerometer unit", "m/s^2"),
        gyro_factor=units.gyro,
        accel_factor=units.accel,
        stamp=found.imu_stamp,
        topic=found.imu or "imu",
    )


def lidar_motion(
    recording: Recording,
    config: RunConfig,
    *,
    threads: int = 1,
    seconds: float = LONGEST,
    watch: Watcher = lambda _what, _done: None,
) -> tuple[LidarMotion | None, str]:
    """Follow the LiDAR alone over the first part of a recording.

    Returns
    -------
    motion : LidarMotion or None
        None where it cannot be followed.
    why : str
        The reason for that; empty otherwise.
    """
    if "lidar" not in recording.sensors:
        return None, "the recording holds no LiDAR"
    sensor = Rig(T_imu_lidar=np.eye(4), source="the lidar frame itself")
    thrifty = replace(config, cloud=replace(config.cloud, target_points=max(1, config.cloud.target_points // 2)))
    odometry = FilterOdometry(thrifty, sensor, sensors=frozenset({"lidar"}), threads=threads)
    results = []
    first_ns: int | None = None
    with closing(recording.stream()) as stream:  # type: ignore[type-var]
        for message in stream:
            if not isinstance(message, Scan):
                continue
            first_ns = message.stamp_ns if first_ns is None else first_ns
            results += odometry.add(_thinned(message))
            watch("scans", len(results))
            if (message.stamp_ns - first_ns) * 1e-9 > seconds:
                break
    results += odometry.finish()
    if len(results) < _ENOUGH_SCANS:
        return None, f"only {len(results)} of the {_ENOUGH_SCANS} scans that are needed can be followed"
    tracked = np.array([result.status in ("first", "tracked", "degenerate") for result in results])
    if np.count_nonzero(tracked) < max(_ENOUGH_SCANS, len(results) // 2):
        return None, f"only {np.count_nonzero(tracked)} of {len(results)} scans could be matched without an IMU"
    stamps_ns, T_odom_lidar = _at_middle(results)
    forward = np.concatenate([[True], np.diff(stamps_ns) > 0])
    trajectory = Trajectory(stamps_ns=stamps_ns[forward], T_frame_body=T_odom_lidar[forward], body="lidar")
    sweep = float(np.median([result.end_ns - result.stamp_ns for result in results])) * 1e-9
    return LidarMotion(trajectory=trajectory, tracked=tracked[forward], rig=recording.rig, sweep=sweep), ""


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


def _thinned(scan: Scan) -> Scan:
    return replace(
        scan,
        points=np.ascontiguousarray(scan.points[::_THINNING]),
        offsets_ns=np.ascontiguousarray(scan.offsets_ns[::_THINNING]),
        intensity=None,
        ring=None,
    )
