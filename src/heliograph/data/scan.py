"""One LiDAR sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen

__all__ = ["Scan"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """One LiDAR message: points with the time of each.

    Parameters
    ----------
    stamp_ns : int
        Time of the sweep's start [ns]; every offset counts from here.
    header_stamp_ns : int
        The message's own stamp, whatever it means (start, middle, end) [ns]. Output rows carry it.
    received_ns : int
        When the recorder got the message [ns]; orders the streams causally.
    end_ns : int
        ``stamp_ns`` plus the largest offset among the message's valid points, before any filtering [ns].
    points : (N, 3) float32
        Finite points in the lidar frame [m].
    offsets_ns : (N,) int32
        Time of each point since ``stamp_ns``, >= 0 [ns].
    intensity : (N,) float32 or None
        Reflectivity in the sensor's own unit.
    ring : (N,) uint16 or None
        Laser or row index.
    frame_id : str
        Name of the lidar frame in the recording.
    has_point_times : bool
        False when the message carried no per-point time (all offsets are then zero, or inferred from geometry).
    """

    stamp_ns: int
    header_stamp_ns: int
    received_ns: int
    end_ns: int
    points: NDArray[np.float32]
    offsets_ns: NDArray[np.int32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.uint16] | None = None
    frame_id: str = "lidar"
    has_point_times: bool = True

    def __post_init__(self) -> None:
        points = frozen("points", self.points, np.float32, (None, 3))
        n = len(points)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "offsets_ns", frozen("offsets_ns", self.offsets_ns, np.int32, (n,)))
        if self.intensity is not None:
            object.__setattr__(self, "intensity", frozen("intensity", self.intensity, np.float32, (n,)))
        if self.ring is not None:
            object.__setattr__(self, "ring", frozen("ring", self.ring, np.uint16, (n,)))

    def __len__(self) -> int:
        return len(self.points)

    def taken(self, keep: NDArray[np.int32]) -> Scan:
        """Return the scan with the points of the indices ``keep`` (M,) only; its times stay."""
        return replace(
            self,
            points=self.points[keep],
            offsets_ns=self.offsets_ns[keep],
            intensity=self.intensity[keep] if self.intensity is not None else None,
            ring=self.ring[keep] if self.ring is not None else None,
        )

    def thinned(self, step: int) -> Scan:
        """Return the scan with every ``step``-th of its points, without intensity and rings; its times stay."""
        return replace(
            self,
            points=np.ascontiguousarray(self.points[::step]),
            offsets_ns=np.ascontiguousarray(self.offsets_ns[::step]),
            intensity=None,
            ring=None,
        )
