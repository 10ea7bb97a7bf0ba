"""Inertial samples and their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.data.arrays import frozen

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
        n = len(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", frozen("stamps_ns", self.stamps_ns, np.int64, (None,)))
        object.__setattr__(self, "gyro", frozen("gyro", self.gyro, np.float64, (n, 3), finite=True))
        object.__setattr__(self, "accel", frozen("accel", self.accel, np.float64, (n, 3), finite=True))

    def __len__(self) -> int:
        return len(self.stamps_ns)


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
