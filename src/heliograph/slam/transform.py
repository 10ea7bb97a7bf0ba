"""Moving clouds."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Points

__all__ = ["transformed"]

_BLOCK = 8192  # points moved at once: with more, BLAS would start threads that then spin beside us


def transformed(points: Points, T: Array) -> Points:
    """Return points (N, 3) float32 moved by a motion (4, 4)."""
    R, t = T[:3, :3].T.astype(np.float32), T[:3, 3].astype(np.float32)
    moved = np.empty_like(points)
    for first in range(0, len(points), _BLOCK):
        np.matmul(points[first : first + _BLOCK], R, out=moved[first : first + _BLOCK])
    moved += t
    return moved
