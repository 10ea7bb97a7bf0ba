"""Speeds by wheels or legs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen

__all__ = ["WheelAccount", "WheelSpeeds"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSpeeds:
    """How fast a point of the body moves, by its wheels or legs.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Times, increasing [ns].
    v_body : (N, 3) float64
        Forward, left, up, in axes of the vehicle [m/s]; NaN in what is not measured.
    received_ns : int
        When the last of them came [ns].
    sigma : (3,) float64
        What the source says of their noise, one-sigma; 0: nothing [m/s].
    T_imu_vehicle : (4, 4) float64, optional
        The vehicle's axes and the point whose speed it is, where the recording tells them.
    """

    stamps_ns: NDArray[np.int64]
    v_body: NDArray[np.float64]
    received_ns: int
    sigma: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    T_imu_vehicle: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamps_ns", frozen("stamps_ns", self.stamps_ns, np.int64, (None,)))
        object.__setattr__(self, "v_body", frozen("v_body", self.v_body, np.float64, (len(self.stamps_ns), 3)))
        object.__setattr__(self, "sigma", frozen("sigma", self.sigma, np.float64, (3,)))
        if self.T_imu_vehicle is not None:
            T = frozen("T_imu_vehicle", self.T_imu_vehicle, np.float64, (4, 4))
            object.__setattr__(self, "T_imu_vehicle", T)

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelAccount:
    """What became of the speeds of a run.

    Parameters
    ----------
    speeds : int
        How many there were.
    steps, slips : int
        Steps between keyframes that they cover, and those that were left out as slip.
    scale, scale_sigma : float
        Metres a measured metre, and its one-sigma; NaN where no step was used.
    """

    speeds: int
    steps: int
    slips: int
    scale: float
    scale_sigma: float
