"""A keyframe at which loops are being looked for, and how far that has come."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.slam.loop_search import Candidate
from heliograph.snapshots import Snapshot, Stateful, array, fixed

__all__ = ["OpenQuery"]


class OpenQuery(Stateful):
    """A keyframe at which loops are being looked for, and how far that has come.

    Parameters
    ----------
    index : int
        The keyframe.
    T_map_imu : (K, 4, 4) float64
        Poses of all keyframes as the graph had them when it began.
    candidates : tuple of Candidate
    """

    _STATE: ClassVar = {
        "index": int,
        "T_map_imu": array(np.float64, None, 4, 4),
        "candidates": [Candidate],
        "at": int,
        "pieces": int,
        "held": [fixed(int, int, int)],
    }

    def __init__(self, index: int, T_map_imu: Array, candidates: tuple[Candidate, ...]) -> None:
        self.index, self.T_map_imu, self.candidates = index, T_map_imu, candidates
        self.at = self.pieces = 0
        """The candidate that is looked at, and pieces of that which are done."""
        self.held: list[tuple[int, int, int]] = []
        """Local maps that were there when it began to be looked at."""

    @classmethod
    def restored(cls, snapshot: Snapshot) -> OpenQuery:
        """Return the query of a snapshot."""
        query = cls(0, np.zeros((0, 4, 4)), ())
        query.restore(snapshot)
        return query
