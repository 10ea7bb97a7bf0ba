"""The map that a run writes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph import _core

__all__ = ["GlobalMap"]


class GlobalMap:
    """One averaged point a cube, with its mean intensity; memory grows with the volume seen, not with time.

    Parameters
    ----------
    voxel : float
        Edge of the cubes [m].
    """

    def __init__(self, voxel: float) -> None:
        self._native = _core.GlobalMap(voxel)

    def insert(
        self, points_imu: NDArray[np.float32], intensity: NDArray[np.float32] | None, T_map_imu: NDArray[np.float64]
    ) -> None:
        """Add points (N, 3) of the imu frame [m] seen from the pose (4, 4), with one intensity each or None."""
        values = np.zeros(0, np.float32) if intensity is None else np.ascontiguousarray(intensity)
        self._native.insert(np.ascontiguousarray(points_imu), values, np.ascontiguousarray(T_map_imu))

    def points(self) -> NDArray[np.float32]:
        """Return the mean point of each cube, (M, 3), map frame [m], in the order in which cubes were first seen."""
        return np.asarray(self._native.points())

    def intensity(self) -> NDArray[np.float32]:
        """Return the mean intensity of each cube, (M,)."""
        return np.asarray(self._native.intensity())

    def counts(self) -> NDArray[np.float32]:
        """Return how many points each cube averaged, (M,)."""
        return np.asarray(self._native.counts())

    @property
    def nbytes(self) -> int:
        """Memory held [bytes]."""
        return int(self._native.bytes())

    def __len__(self) -> int:
        return len(self._native)
