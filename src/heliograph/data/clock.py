"""The IMU's clock against the LiDAR's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Stamps

__all__ = ["ImuClock"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuClock:
    """What the IMU's clock shows when the LiDAR's shows ``t``: ``t + offset + drift (t - reference)``.

    The LiDAR's clock is the recording's time: trajectories carry its stamps. A positive offset means that the IMU's
    samples carry later stamps than the LiDAR would have given them.

    Parameters
    ----------
    offset : float
        At the reference [s].
    drift : float
        Change of the offset with time [s/s]; 1e-6 is 1 ppm.
    reference_ns : int
        LiDAR time at which the offset holds [ns].
    """

    offset: float = 0.0
    drift: float = 0.0
    reference_ns: int = 0

    @property
    def exact(self) -> bool:
        """Whether both clocks agree."""
        return self.offset == 0.0 and self.drift == 0.0

    def offset_at(self, lidar_ns: Stamps) -> NDArray[np.float64]:
        """Return how far the IMU's clock is ahead at stamps of the LiDAR, (N,) [s]."""
        return np.asarray(self.offset + self.drift * (1e-9 * (np.asarray(lidar_ns) - self.reference_ns)))

    def imu_time(self, lidar_ns: Stamps) -> Stamps:
        """Return what the IMU's clock shows at stamps of the LiDAR's, (N,) int64 [ns]."""
        stamps = np.asarray(lidar_ns, dtype=np.int64)
        return np.asarray(stamps + np.rint(1e9 * self.offset_at(stamps)).astype(np.int64))

    def lidar_time(self, imu_ns: Stamps) -> Stamps:
        """Return what the LiDAR's clock shows at stamps of the IMU's, (N,) int64 [ns]; undoes `imu_time` to 1 ns."""
        stamps = np.asarray(imu_ns, dtype=np.int64)
        # The difference to the reference in whole nanoseconds: a double holds an hour of them exactly, not a date.
        late = 1e9 * self.offset
        since = (stamps - self.reference_ns).astype(np.float64) - late
        return np.asarray(stamps - np.rint(late + self.drift / (1.0 + self.drift) * since).astype(np.int64))

    def after(self, applied: ImuClock) -> ImuClock:
        """Return the whole clock where this one was found on samples whose stamps ``applied`` had corrected already."""
        at_reference = np.int64(self.reference_ns + round(1e9 * self.offset))
        return ImuClock(
            offset=self.offset + float(applied.offset_at(at_reference)),
            drift=self.drift + applied.drift + self.drift * applied.drift,
            reference_ns=self.reference_ns,
        )
