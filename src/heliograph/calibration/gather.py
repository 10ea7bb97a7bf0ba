"""What a calibration starts from: thinned scans, inertial samples, and where the LiDAR alone finds that it was."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.config import RunConfig
from heliograph.data import GnssFix, ImuBatch, Scan
from heliograph.errors import DataError
from heliograph.odometry.follow import follow_lidar

__all__ = ["CalibrationData", "gather", "refined", "thinned"]

Message: TypeAlias = Scan | ImuBatch | GnssFix

_MIN_SCANS, _MIN_SAMPLES = 20, 20
_EVENNESS = 0.2  # by which share neighbouring sample periods may differ for a cubic through them to make sense


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationData:
    """The data of a calibration.

    Parameters
    ----------
    scans : tuple of Scan
        Thinned, in order, those that the LiDAR's own odometry could place.
    imu : ImuBatch
        All samples, as stamped.
    T_odom_lidar : (N, 4, 4) float64
        Pose of the LiDAR at each scan's end, by its odometry alone [m].
    """

    scans: tuple[Scan, ...]
    imu: ImuBatch
    T_odom_lidar: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def ends_ns(self) -> NDArray[np.int64]:
        """Ends of the scans, (N,) [ns]."""
        return np.array([scan.end_ns for scan in self.scans], dtype=np.int64)

    @property
    def duration(self) -> float:
        """From the first scan's start to the last one's end [s]."""
        return (self.scans[-1].end_ns - self.scans[0].stamp_ns) * 1e-9


def gather(stream: Iterable[Message], config: RunConfig, *, threads: int = 1) -> CalibrationData:
    """Read a recording and run the LiDAR alone over it.

    Parameters
    ----------
    stream : iterable of Scan and ImuBatch
        The recording's messages; read once, up to ``config.calibration.longest``.
    config : RunConfig
    threads : int

    Raises
    ------
    DataError
        Too few scans that match each other, or too few inertial samples.
    """
    scans: dict[int, Scan] = {}
    batches: list[ImuBatch] = []

    def taken() -> Iterator[Scan]:
        for message in stream:
            if isinstance(message, ImuBatch):
                batches.append(message)
            if not isinstance(message, Scan):
                continue
            scan = thinned(message, config.calibration.points)
            if scans and (scan.end_ns - next(iter(scans))) * 1e-9 > config.calibration.longest:
                return
            scans[scan.end_ns] = scan
            yield scan

    followed = follow_lidar(taken(), config, matches=config.calibration.matches, threads=threads)
    poses = {result.end_ns: result.T_odom_imu for result in followed if result.matched}
    ends = [end for end in scans if end in poses]
    samples = sum(len(batch) for batch in batches)
    if len(ends) < _MIN_SCANS or samples < _MIN_SAMPLES:
        raise DataError(
            f"{len(ends)} scans that match each other and {samples} inertial samples are too few to calibrate with "
            f"(at least {_MIN_SCANS} of each); record some 30 s of motion before walls that the LiDAR sees well"
        )
    return CalibrationData(
        scans=tuple(scans[end] for end in ends),
        imu=ImuBatch.joined(batches),
        T_odom_lidar=np.stack([poses[end] for end in ends]),
    )


def refined(imu: ImuBatch) -> ImuBatch:
    """Return the samples with one more half way between each two, on the cubic through the four around it.

    The straight line between samples that integration assumes cuts the tops of a motion: of one with frequency f
    sampled each T seconds it takes the share ``(2 pi f T)^2 / 12``. At 200 Hz that is little, but a calibration sees
    it: some 10 us of clock offset. Where the periods differ, as in gaps, nothing is put in.
    """
    steps = np.diff(imu.stamps_ns).astype(np.float64)
    around = np.stack([steps[:-2], steps[1:-1], steps[2:]])
    even = around.max(axis=0) - around.min(axis=0) <= _EVENNESS * around[1]
    k = 1 + np.flatnonzero(even)  # the middle lies between samples k and k + 1

    def with_middles(samples: Array) -> Array:
        outer, inner = samples[k - 1] + samples[k + 2], samples[k] + samples[k + 1]
        return np.insert(samples, k + 1, (9.0 * inner - outer) / 16.0, axis=0)

    middles = imu.stamps_ns[k] + (imu.stamps_ns[k + 1] - imu.stamps_ns[k]) // 2
    return replace(
        imu,
        stamps_ns=np.insert(imu.stamps_ns, k + 1, middles),
        gyro=with_middles(imu.gyro),
        accel=with_middles(imu.accel),
    )


def thinned(scan: Scan, points: int) -> Scan:
    """Return the scan with at most about ``points`` of its points, taken at equal steps."""
    return scan.thinned(max(1, -(-len(scan) // points)))
