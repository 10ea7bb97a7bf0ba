"""Speeds by wheels or legs."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    stamps_ns: NDArray[np.int64]
    v_body: NDArray[np.float64]
    received_ns: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamps_ns", frozen("stamps_ns", self.stamps_ns, np.int64, (None,)))
        object.__setattr__(self, "v_body", frozen("v_body", self.v_body, np.float64, (len(self.stamps_ns), 3)))

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
