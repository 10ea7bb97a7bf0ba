"""How far back the local map reaches: by the way gone since, and by what the map's frame may have drifted since.

What a scan is matched to is what the odometry's own covariance vouches for. A surface lies where the pose that saw it
last has put it, and the pose of now differs from that one by the drift in between. Matched all the same, it closes a
loop without asking whether the place is the same: the floor below, the next of three equal corridors. Such loops are
the back-end's, which verifies them. What is still in view is seen anew by every scan and stays, however long the way.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.config import MapConfig
from heliograph.snapshots import Stateful, array

__all__ = ["MapWindow", "WindowMark"]

_STRIDE = 0.5  # the way counts in strides of this length, so that the noise of a pose at rest does not add up [m]
_STEPS = 6.0  # the map is looked through for what has left the window this often while the sensor goes its length


@dataclass(frozen=True, slots=True)
class WindowMark:
    """How many scans had been inserted, the way gone by then, and the variance that the frame had walked."""

    scans: int
    way: float
    walked: float


class MapWindow(Stateful):
    """Tells from when on the map may be matched.

    Parameters
    ----------
    config : MapConfig
        ``window`` and ``window_drift``.
    """

    _STATE: ClassVar = {
        "_marks": [WindowMark],
        "_scans": int,
        "_way": float,
        "_at": (array(np.float64, 3), None),
        "_done": (WindowMark, None),
    }

    def __init__(self, config: MapConfig) -> None:
        self._length, self._drift = config.window, config.window_drift
        self._marks: deque[WindowMark] = deque()
        self._scans, self._way = 0, 0.0
        self._at: Array | None = None
        self._done: WindowMark | None = None

    def begin(self) -> None:
        """Begin anew: the map was cleared."""
        self._marks.clear()
        self._scans, self._way, self._at, self._done = 0, 0.0, None, None

    def moved(self, position_odom: Array, walked: float) -> int | None:
        """Take in a scan inserted at a position (3,), and the variance that the frame has walked by then [m^2].

        Returns
        -------
        int or None
            How many of the last scans vouch for a surface: what none of them has seen is to be forgotten. None where
            the window has not moved on by enough to look.
        """
        if self._length <= 0.0:
            return None
        self._scans += 1
        if self._at is None:
            self._at = position_odom
        stride = float(np.linalg.norm(position_odom - self._at))
        if stride >= _STRIDE:
            self._way, self._at = self._way + stride, position_odom
        now = WindowMark(self._scans, self._way, walked)
        if self._marks and self._marks[-1].way == self._way and self._marks[-1].walked == walked:
            self._marks[-1] = now
        elif not self._marks or self._parts(self._marks[-1], now) > _STRIDE / self._length:
            self._marks.append(now)
        while len(self._marks) > 1 and self._parts(self._marks[1], now) > 1.0:
            self._marks.popleft()
        oldest = self._marks[0]
        if self._parts(oldest, now) <= 1.0:
            return None
        if self._done is not None and self._parts(self._done, oldest) < 1.0 / _STEPS:
            return None
        self._done = oldest
        return self._scans - oldest.scans

    def _parts(self, a: WindowMark, b: WindowMark) -> float:
        """Return which part of the window lies between two marks, by way or by drift, whichever is more."""
        return max((b.way - a.way) / self._length, float(np.sqrt(max(b.walked - a.walked, 0.0))) / self._drift)
