"""A fault of a recording that was mended, and how."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data.clock import ImuClock
from heliograph.data.rig import Rig

__all__ = ["SensorRepair"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRepair:
    """What is done to the messages of a recording before they are used.

    Parameters
    ----------
    code : str
        Short stable name, e.g. ``"accel-axes"``.
    sentence : str
        What was wrong, the evidence, and what was done, in one line.
    gyro, accel : (3, 3) float64
        What the samples are multiplied by: axes and units; the identity where they are right.
    clock : ImuClock
        The IMU's clock against the LiDAR's, on top of what the reader has applied.
    rig : Rig or None
        The mounting to use instead of the recording's.
    without_imu : bool
        Whether the inertial samples are left out altogether.
    times_reversed : bool
        Whether the times of a scan's points are counted from the sweep's other end.
    """

    code: str
    sentence: str
    gyro: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    accel: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    clock: ImuClock = field(default_factory=ImuClock)
    rig: Rig | None = None
    without_imu: bool = False
    times_reversed: bool = False

    def __post_init__(self) -> None:
        freeze(self)
