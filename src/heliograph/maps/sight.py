"""What one scan saw through: the rays from the sensor to its points, held against a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_pose, freeze

__all__ = ["Sight", "count_seen_through"]

_NO_NORMALS = np.zeros((0, 3), np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """The rays of one scan.

    Parameters
    ----------
    origin : (3,) float64
        Where the sensor was at the end of the sweep [m].
    start : (3,) float64
        Where it was at its beginning [m].
    ends : (B, 3) float32
        Where the rays ended, from ``origin`` [m].
    """

    origin: NDArray[np.float64]
    start: NDArray[np.float64]
    ends: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self)

    def moved(self, T: NDArray[np.float64]) -> Sight:
        """Return it in another frame, ``T`` (4, 4)."""
        R, t = as_pose("T", T)[:3, :3], T[:3, 3]
        ends = np.ascontiguousarray(self.ends @ R.T.astype(np.float32))
        return Sight(origin=R @ self.origin + t, start=R @ self.start + t, ends=ends)


def count_seen_through(
    places: NDArray[np.float64],
    sight: Sight,
    votes: NDArray[np.uint16],
    *,
    normals: NDArray[np.float32] | None = None,
    radius: float,
    reach: float,
    margin: float,
    grazing: float,
) -> None:
    """Add one to the votes of the places that a ray passes through while none ends at them.

    Parameters
    ----------
    places : (M, 3) float64
        In the sight's frame, whose z axis points up [m].
    sight : Sight
    votes : (M,) uint16
        Added to.
    normals : (M, 3) float32, optional
        Normals of the surfaces at the places; zero where there is none.
    radius : float
        A ray passes through a place when it passes within this of it, from either end of the sensor's way [m].
    reach : float
        Places farther off are left alone [m].
    margin : float
        A ray must go on behind a place for this [m], or two hundredths of the distance, and for longer than it takes to
        leave the surface there, or level ground below the sensor.
    grazing : float
        Sine of the angle between ray and surface below which nothing is said.

    Notes
    -----
    The visibility test of A. Schauer and A. Nuechter (The Peopleremover, RA-L 2018), G. Kim and A. Kim (Remove, then
    revert, IROS 2020) and D. Duberg et al. (DUFOMap, RA-L 2024) on the rays themselves: what cells of a grid or of a
    range image cannot tell at grazing incidence, the distance between ray and place can.
    """
    near = np.ascontiguousarray(places - sight.origin, dtype=np.float32)
    start = (sight.start - sight.origin).astype(np.float32)
    _core.count_seen_through(
        near, _NO_NORMALS if normals is None else normals, sight.ends, start, radius, reach, margin, grazing,
        as_array("votes", votes, np.uint16, (len(near),)),
    )  # fmt: skip
