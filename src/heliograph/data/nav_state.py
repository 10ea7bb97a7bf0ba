"""The navigation state that the filter estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data.clock import ImuClock

__all__ = ["NavState"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NavState:
    """Pose, velocity, biases, gravity, mounting and clock at one instant, with the covariance of their errors.

    Parameters
    ----------
    stamp_ns : int
        [ns].
    R_odom_imu : (3, 3) float64
    p_odom, v_odom : (3,) float64
        Position [m] and velocity [m/s].
    gyro_bias, accel_bias : (3,) float64
        [rad/s], [m/s^2].
    g_odom : (3,) float64
        Gravity [m/s^2]; its length is known, its direction lives on S(2). Zero without an IMU.
    T_imu_lidar : (4, 4) float64
        Mounting [m].
    covariance : (K, K) float64
        Its rows are those of `heliograph.data.error_layout`. K = 17: rotation (body) 3, position (odom) 3, velocity
        (odom) 3, gyro bias 3, accelerometer bias 3, gravity direction 2. K = 23 adds mounting rotation (lidar) 3 and
        lever arm (imu) 3, K = 25 also the clock's offset and drift, K = 26 the scale of wheels or legs too.
    imu_offset : float
        What the IMU's clock shows more than the LiDAR's, whose stamps the state bears, at ``stamp_ns`` [s].
    imu_drift : float
        Change of that offset with time [s/s]; 1e-6 is 1 ppm.
    wheel_scale : float
        Metres a metre that wheels or legs measure.
    """

    stamp_ns: int
    R_odom_imu: NDArray[np.float64]
    p_odom: NDArray[np.float64]
    v_odom: NDArray[np.float64]
    gyro_bias: NDArray[np.float64]
    accel_bias: NDArray[np.float64]
    g_odom: NDArray[np.float64]
    T_imu_lidar: NDArray[np.float64]
    covariance: NDArray[np.float64]
    imu_offset: float = 0.0
    imu_drift: float = 0.0
    wheel_scale: float = 1.0

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def imu_clock(self) -> ImuClock:
        """The IMU's clock as this state has it."""
        return ImuClock(offset=self.imu_offset, drift=self.imu_drift, reference_ns=self.stamp_ns)

    @property
    def T_odom_imu(self) -> NDArray[np.float64]:
        """The pose as a (4, 4) matrix."""
        T = np.eye(4)
        T[:3, :3] = self.R_odom_imu
        T[:3, 3] = self.p_odom
        return T
