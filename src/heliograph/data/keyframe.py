"""A keyframe: one scan of a run that the back-end keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.data.imu import ImuBatch

__all__ = ["Keyframe"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyframe:
    """The state at the end of a scan, its thinned cloud, and what was measured since the keyframe before.

    Parameters
    ----------
    index : int
        Number of the keyframe, from 0.
    stamp_ns : int
        End of its scan [ns].
    T_odom_imu : (4, 4) float64
        Pose as the odometry gave it.
    v_odom, gyro_bias, accel_bias, g_odom : (3,) float64
        Velocity [m/s], biases [rad/s], [m/s^2] and gravity [m/s^2]; gravity is zero without an IMU.
    step_covariance : (6, 6) float64
        Covariance of the odometry's step from the keyframe before: a right perturbation (rotation, translation) of
        ``inverse(T_odom_imu before) @ T_odom_imu``. Zero for the first.
    lidar_information : (6, 6) float64
        What the scan alone told of a right perturbation of `T_odom_imu` against the map.
    points_imu : (N, 3) float32
        De-skewed and thinned, imu frame at ``stamp_ns`` [m].
    intensity : (N,) float32 or None
    imu : ImuBatch
        Samples since the keyframe before, one sample beyond either end where there is one; empty without an IMU.
    """

    index: int
    stamp_ns: int
    T_odom_imu: NDArray[np.float64]
    v_odom: NDArray[np.float64]
    gyro_bias: NDArray[np.float64]
    accel_bias: NDArray[np.float64]
    g_odom: NDArray[np.float64]
    step_covariance: NDArray[np.float64]
    lidar_information: NDArray[np.float64]
    points_imu: NDArray[np.float32]
    intensity: NDArray[np.float32] | None
    imu: ImuBatch

    def __post_init__(self) -> None:
        shapes = {
            "T_odom_imu": (4, 4), "v_odom": (3,), "gyro_bias": (3,), "accel_bias": (3,), "g_odom": (3,),
            "step_covariance": (6, 6), "lidar_information": (6, 6),
        }  # fmt: skip
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, shape, finite=True))
        points = frozen("points_imu", self.points_imu, np.float32, (None, 3), finite=True)
        object.__setattr__(self, "points_imu", points)
        if self.intensity is not None:
            object.__setattr__(self, "intensity", frozen("intensity", self.intensity, np.float32, (len(points),)))
