"""How the sensors are mounted, and how their clocks agree."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.data.clock import ImuClock

__all__ = ["Rig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """The LiDAR's mounting on the IMU and where that knowledge comes from.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        ``p_imu = T_imu_lidar @ p_lidar`` [m].
    source : str
        In words, e.g. ``"tf_static"``, ``"file calib.toml"``, ``"factory, Livox Mid-360"``, ``"unknown"``.
    known : bool
        False when no source gave it: the rotation must then be aligned from the data.
    sigma_rotation : float
        One-sigma of the mounting rotation about each axis [rad].
    sigma_translation : float
        One-sigma of the lever arm along each axis [m].
    clock : ImuClock
        The IMU's clock against the LiDAR's.
    antenna_imu : (3,) float64 or None
        The satellite receiver's antenna in the imu frame [m]; None: not known.
    """

    T_imu_lidar: NDArray[np.float64]
    source: str
    known: bool = True
    sigma_rotation: float = 0.0
    sigma_translation: float = 0.0
    clock: ImuClock = field(default_factory=ImuClock)
    antenna_imu: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        value = frozen("T_imu_lidar", self.T_imu_lidar, np.float64, (4, 4), finite=True)
        object.__setattr__(self, "T_imu_lidar", value)
        if self.antenna_imu is not None:
            antenna = frozen("antenna_imu", self.antenna_imu, np.float64, (3,), finite=True)
            object.__setattr__(self, "antenna_imu", antenna)
