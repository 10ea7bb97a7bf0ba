"""What a calibration passes from step to step."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.arrays import Array, Stamps, freeze
from heliograph.data import ImuClock

__all__ = ["CalibrationMotion", "CalibrationState", "LidarPoses", "RigPrior"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationState:
    """What is estimated besides the motion.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        [m].
    clock : ImuClock
    g_odom : (3,) float64
        Gravity; its length is given [m/s^2].
    """

    T_imu_lidar: Array
    clock: ImuClock
    g_odom: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigPrior:
    """The prior of mounting and clock.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        [m].
    clock : ImuClock
    information : (8, 8) float64
        Information about a change from it: rotation about and lever arm along imu axes, offset, drift.
    """

    T_imu_lidar: Array
    clock: ImuClock
    information: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarPoses:
    """Poses of the LiDAR in the odom frame as estimated from the scans alone.

    Parameters
    ----------
    stamps_ns : (N,) int64
        In the LiDAR's clock [ns].
    T_odom_lidar : (N, 4, 4) float64
        [m].
    covariance : (N, 6, 6) float64
        Covariance of right perturbations, rotation first; its size by direction is found from the data.
    """

    stamps_ns: Stamps
    T_odom_lidar: Array
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationMotion:
    """The IMU's states at some instants.

    Parameters
    ----------
    stamps_ns : (N,) int64
        In the IMU's clock [ns].
    X_odom_imu : (N, 5, 5) float64
        Extended poses: attitude, position [m], velocity [m/s].
    bias : (N, 6) float64
        Gyroscope [rad/s], accelerometer [m/s^2].
    """

    stamps_ns: Stamps
    X_odom_imu: Array
    bias: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.stamps_ns)
