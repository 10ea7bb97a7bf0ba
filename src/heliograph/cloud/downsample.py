"""Thinning: fewer points, spread evenly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_points
from heliograph.errors import DataError

__all__ = ["range_gate", "voxel_downsample"]


def voxel_downsample(points: NDArray[np.float32], leaf: float) -> NDArray[np.int32]:
    """Return the index of one finite point in each cube of edge ``leaf`` [m], (M,) int32 in the order of the cubes.

    Which one is drawn by a hash of the coordinates, so that the points picked, and their order, do not depend on the
    order in which a driver stores them, and favour no side of a surface.
    A point is kept as measured rather than averaged: an average of a curved or mixed cube lies on no surface.

    Raises
    ------
    DataError
        ``points`` are not (N, 3) float32, or ``leaf`` is not positive.
    """
    points = as_points("points", points)
    if not 0.0 < leaf < np.inf:
        raise DataError(f"leaf is {leaf}, expected an edge above 0 m")
    return np.asarray(_core.voxel_downsample(points, leaf))


def range_gate(points: NDArray[np.float32], min_range: float, max_range: float) -> NDArray[np.int32]:
    """Return the indices of the finite points at a distance in [``min_range``, ``max_range``] [m], (M,) int32.

    Raises
    ------
    DataError
        ``points`` are not (N, 3) float32.
    """
    points = as_points("points", points)
    return np.asarray(_core.range_gate(points, min_range, max_range))
