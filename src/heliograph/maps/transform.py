"""Moving clouds."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Points

__all__ = ["transformed"]

_BLOCK = 8192  # points moved at once: with more, BLAS would start threads that then spin beside us


def transformed(points: Points, T: Array) -> Points:
    """Return points moved by a motion, each computed in float64 and rounded once.

    Parameters
    ----------
    points : (N, 3) float32
        [m].
    T : (4, 4) float64
    """
    moved = np.empty_like(points)
    for first in range(0, len(points), _BLOCK):
        block = points[first : first + _BLOCK].astype(np.float64)
        moved[first : first + _BLOCK] = block @ T[:3, :3].T + T[:3, 3]
    return moved
