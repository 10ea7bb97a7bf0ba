"""Inertial samples and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen

__all__ = ["ImuBatch", "ImuNoise"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuBatch:
    """Consecutive samples of one IMU, in the imu frame, in time order.

    Parameters
    ----------
    stamps_ns : (M,) int64
        Sample times, strictly increasing [ns].
    gyro : (M, 3) float64
        Angular rate of the imu frame [rad/s].
    accel : (M, 3) float64
        Specific force ``R^T (a - g) + bias`` [m/s^2]; +g up at rest.
    received_ns : int
        When the recorder got the last of them [ns].
    frame_id : str
        Name of the imu frame in the recording.
    """

    stamps_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    received_ns: int
    frame_id: str = "imu"

    def __post_init__(self) -> None:
        stamps = frozen("stamps_ns", self.stamps_ns, np.int64, (None,))
        n = len(stamps)
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "gyro", frozen("gyro", self.gyro, np.float64, (n, 3), finite=True))
        object.__setattr__(self, "accel", frozen("accel", self.accel, np.float64, (n, 3), finite=True))

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, part: slice | NDArray[np.bool_] | NDArray[np.intp]) -> ImuBatch:
        """Return some of the samples, chosen by a slice, a mask or indices in time order."""
        return replace(self, stamps_ns=self.stamps_ns[part], gyro=self.gyro[part], accel=self.accel[part])

    @classmethod
    def joined(cls, batches: Sequence[ImuBatch]) -> ImuBatch:
        """Return the samples of several batches in time order as one; that of none is empty.

        It was received with the last batch and bears the frame of the first.
        """
        if not batches:
            return cls(stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)), received_ns=0)
        return cls(
            stamps_ns=np.concatenate([batch.stamps_ns for batch in batches]),
            gyro=np.concatenate([batch.gyro for batch in batches]),
            accel=np.concatenate([batch.accel for batch in batches]),
            received_ns=batches[-1].received_ns,
            frame_id=batches[0].frame_id,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuNoise:
    """Continuous noise densities of an IMU, one sigma an axis.

    Parameters
    ----------
    gyro : float
        Gyroscope white noise [rad/s/sqrt(Hz)].
    accel : float
        Accelerometer white noise [m/s^2/sqrt(Hz)].
    gyro_walk : float
        Gyroscope bias random walk [rad/s^2/sqrt(Hz)].
    accel_walk : float
        Accelerometer bias random walk [m/s^3/sqrt(Hz)].
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
