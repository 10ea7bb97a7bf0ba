"""Inertial messages as a recording holds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen

__all__ = ["ImuRecord"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuRecord:
    """All messages of an IMU as they were recorded: order, stamps and units untouched, damaged ones included.

    Parameters
    ----------
    stamps_ns, received_ns : (N,) int64
        The messages' own stamps, and when the recorder got them [ns].
    gyro, accel : (N, 3) float64
        In the recording's own units; NaN where the message holds none.
    gyro_unit, accel_unit : str
        What the reader took the units for.
    gyro_factor, accel_factor : float
        From these units to rad/s and m/s^2.
    stamp : str
        ``"header"``, or ``"received"`` where the reader had to fall back on the times of reception.
    topic : str
        Where the messages come from.
    """

    stamps_ns: NDArray[np.int64]
    received_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    gyro_unit: str = "rad/s"
    accel_unit: str = "m/s^2"
    gyro_factor: float = 1.0
    accel_factor: float = 1.0
    stamp: str = "header"
    topic: str = "imu"

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        for name in ("stamps_ns", "received_ns"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.int64, (n,)))
        for name in ("gyro", "accel"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, (n, 3)))

    def __len__(self) -> int:
        return len(self.stamps_ns)
