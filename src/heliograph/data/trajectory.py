"""A stamped path of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.errors import DataError

__all__ = ["Trajectory"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Poses of a body frame in a fixed frame, in time order.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Times, non-decreasing [ns].
    T_frame_body : (N, 4, 4) float64
        ``p_frame = T_frame_body @ p_body`` [m].
    frame : str
        Name of the fixed frame.
    body : str
        Name of the moving frame.
    """

    stamps_ns: NDArray[np.int64]
    T_frame_body: NDArray[np.float64]
    frame: str = "odom"
    body: str = "imu"

    def __post_init__(self) -> None:
        stamps = frozen("stamps_ns", self.stamps_ns, np.int64, (None,))
        n = len(stamps)
        object.__setattr__(self, "stamps_ns", stamps)
        value = frozen("T_frame_body", self.T_frame_body, np.float64, (n, 4, 4), finite=True)
        object.__setattr__(self, "T_frame_body", value)
        if n > 1 and int(np.diff(self.stamps_ns).min()) < 0:
            raise DataError("trajectory stamps run backwards; sort the rows by time")

    def __len__(self) -> int:
        return len(self.stamps_ns)
