"""What a local map must do; `heliograph.testing.assert_local_map` is its law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze

__all__ = ["NEIGHBOURS", "LocalMap", "PlaneMatches", "WindowedMap"]

NEIGHBOURS = 255
"""Source of a plane through nearest neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneMatches:
    """One plane a query.

    Parameters
    ----------
    normal : (N, 3) float32
        Unit normals, odom frame; any where ``source`` is 0.
    point : (N, 3) float64
        A point of each plane, odom frame [m].
    variance : (N,) float32
        Variance of the plane across itself at the query [m^2].
    tilt : (N,) float32 or None
        Variance of each normal about either axis across it [rad^2]; what is not told counts as exact, and many planes
        then seem to tell about directions that none of them faces.
    scatter : (N,) float32 or None
        Variance of each plane's points about it [m^2]; negative where it is not known.
    since : (N,) float32 or None
        Mean number of the insertions that each plane's points came with, the first being 1; negative where it is not
        known. Without both, what scans after one another err alike is not counted.
    source : (N,) uint8
        0 no plane, `NEIGHBOURS` a plane through nearest neighbours, else 1 + the map's level.
    """

    normal: NDArray[np.float32]
    point: NDArray[np.float64]
    variance: NDArray[np.float32]
    source: NDArray[np.uint8]
    tilt: NDArray[np.float32] | None = None
    scatter: NDArray[np.float32] | None = None
    since: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        freeze(self)


@runtime_checkable
class LocalMap(Protocol):
    """The part of the world around the sensor that scans are matched against. It changes only by its verbs.

    These verbs are all that the filter asks, with mounting and clock estimated too: what an error of the mounting does
    to a map follows from the pose that it was begun at, which the filter knows, and a map that was made with a wrong
    mounting is cleared.
    """

    def insert(self, points_body: NDArray[np.float32], T_odom_body: NDArray[np.float64]) -> float:
        """Add points (N, 3) of the body frame seen from the pose (4, 4).

        Returns the share in [0, 1] of the scan's surroundings that the map did not hold before: 1 for the first scan, 0
        where nothing is new. The odometry's uncertainty grows with it.
        """
        ...

    def prune(self, centre_odom: NDArray[np.float64]) -> None:
        """Forget what lies farther from ``centre_odom`` (3,) than the map's bound, and what exceeds its count."""
        ...

    def clear(self) -> None:
        """Forget everything: the next insertion begins a new map."""
        ...

    def planes_at(self, points_odom: NDArray[np.float64], *, gate: float) -> PlaneMatches:
        """Return for each point (N, 3) the plane near it, if one lies within ``gate`` [m]."""
        ...

    def __len__(self) -> int:
        """Return the number of stored elements; 0 when nothing can be matched."""
        ...


@runtime_checkable
class WindowedMap(LocalMap, Protocol):
    """A local map that can forget what has not been seen for a while.

    Without this verb a map keeps all that its own bounds allow: a sensor that returns after a long way is matched to
    what it saw then, be it that place or one that looks alike.
    """

    def forget_unseen(self, insertions: int) -> None:
        """Forget what none of the last ``insertions`` insertions added a point to, full elements included."""
        ...
