"""How far a map is from the simulated world that it is of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.errors import DataError
from heliograph.sim.world import SimulatedWorld

__all__ = ["MapError", "map_error"]

_SAMPLE = 100_000  # points that are measured of a larger map
_FAR = 0.05  # [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapError:
    """Distances of a map's points from the surfaces of a world.

    Parameters
    ----------
    points : int
        How many were measured, an even choice of very many.
    median, p95 : float
        Half of them, and 95 %, are no farther [m].
    far_share : float
        Share of those that are more than 0.05 m off: smear, doubled walls, and what moved.
    """

    points: int
    median: float
    p95: float
    far_share: float

    def __post_init__(self) -> None:
        freeze(self)


def map_error(world: SimulatedWorld, points_world: NDArray[np.float64]) -> MapError:
    """Measure a map's points (N, 3), in the world's frame [m].

    Raises
    ------
    DataError
        There is no point, or an array of another dtype or shape.
    """
    if len(points_world) == 0:
        raise DataError("the map holds no point that could be compared with the world")
    off = world.distance(np.ascontiguousarray(points_world[:: -(-len(points_world) // _SAMPLE)]))
    median, p95 = np.quantile(off, (0.5, 0.95))
    return MapError(points=len(off), median=float(median), p95=float(p95), far_share=float(np.mean(off > _FAR)))
