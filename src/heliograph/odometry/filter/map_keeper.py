"""The local map in the filter's hands: what is inserted, forgotten and begun anew, and how far its frame may drift."""

from __future__ import annotations

from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.config import FilterConfig, MapConfig
from heliograph.data import NavState
from heliograph.data.error_layout import POSE_DIM
from heliograph.imu import ErrorGrowth
from heliograph.maps import WindowedMap
from heliograph.odometry.filter.drift import MapDrift
from heliograph.odometry.filter.lasting import LastingErrors, MatchedPoints
from heliograph.odometry.filter.map_window import MapWindow
from heliograph.registration import TrueShare
from heliograph.snapshots import PART, Stateful, array

__all__ = ["GrowingMap", "MapKeeper"]

P_contra = TypeVar("P_contra", contravariant=True)
P = TypeVar("P")
"""Kind of points that a map takes."""


class GrowingMap(Protocol[P_contra]):
    """What is asked of a map here: the verbs of a `LocalMap` that change it, for points of any kind."""

    def insert(self, points_body: P_contra, T_odom_body: NDArray[np.float64], /) -> float:
        """Add points of the body frame seen from a pose; return which share of their surroundings was new."""
        ...

    def prune(self, centre_odom: NDArray[np.float64], /) -> None:
        """Forget what is too far away or too much."""
        ...

    def clear(self) -> None:
        """Forget everything."""
        ...

    def __len__(self) -> int:
        """Return the number of stored elements."""
        ...


_PRUNE_DISTANCE = 10.0  # the map is pruned when the sensor has gone this far [m]


class MapKeeper(Stateful, Generic[P]):
    """A local map, how many scans it holds, how far back it reaches, and the drift of its frame.

    Parameters
    ----------
    local_map : GrowingMap
        One that is no `WindowedMap` keeps all that its own bounds allow.
    config : FilterConfig
    window : MapConfig
        How far back the map reaches.
    centre : (3,) float64
        Where the sensor is, odom frame [m].
    """

    _STATE: ClassVar = {
        "scans": int,
        "drift": PART,
        "_lasting": PART,
        "_window": PART,
        "_pruned_at": array(np.float64, 3),
    }

    def __init__(self, local_map: GrowingMap[P], config: FilterConfig, window: MapConfig, centre: Array) -> None:
        self.map = local_map
        self.scans = 0
        """Scans inserted since the map was begun."""
        self.drift = MapDrift(config.systematic)
        """How far the map's frame may have drifted."""
        self._lasting = LastingErrors(config.typical_range)
        self._window = MapWindow(window)
        self._pruned_at = centre

    @property
    def empty(self) -> bool:
        """Whether nothing can be matched."""
        return len(self.map) == 0

    def extend(
        self,
        points_imu: P,
        pose: Array,
        state: NavState,
        seen: TrueShare | None,
        matched: MatchedPoints | None = None,
    ) -> NavState:
        """Insert a scan, account for what the map's frame may have drifted by that, and forget what is far or long ago.

        Returns the state in the frame that the map defines now; it differs in its covariance only.

        Parameters
        ----------
        points_imu : (N, 3) float32, or what the map takes
            De-skewed points [m].
        pose : (4, 4) float64
            Where to insert them.
        state : NavState
            The state at the scan's end.
        seen : TrueShare or None
            What the match that gave the pose saw of it; None where the pose defines the map.
        matched : MatchedPoints, optional
            What was matched; without it what lasts from scan to scan is not counted.
        """
        self.scans = 1 if self.empty else self.scans + 1
        drag = self._lasting.dragged(self.map, state, seen, matched)
        share = self.map.insert(points_imu, pose)
        if seen is None:
            self.drift.begin(share)
        else:
            if not seen.share.all():
                state = self.drift.hand_over(state, seen.blind())
            # Matched with one match an axis; all of them tell a third of their number as much.
            state = self.drift.grow(state, share, seen.covariance() * seen.matches / 3.0)
            if drag is not None:
                self.drift.drag(drag)
        vouching = self._window.moved(state.p_odom, self.drift.walked)
        if vouching is not None and isinstance(self.map, WindowedMap):
            self.map.forget_unseen(vouching)
        if float(np.linalg.norm(state.p_odom - self._pruned_at)) > _PRUNE_DISTANCE:
            self.map.prune(state.p_odom)
            self._pruned_at = state.p_odom
        return state

    def predicted(self, growth: ErrorGrowth) -> None:
        """Carry on what the map's frame has in common with the state over a prediction."""
        self.drift.predicted(growth)

    def updated(self, retained: Array) -> None:
        """Carry it on over an update that left ``retained`` (K, K) of the state's errors."""
        self.drift.updated(retained)

    def begin_anew(self, state: NavState) -> NavState:
        """Forget the map; the next scan's pose ties the new one to the odom frame, with the error that it has now.

        Returns the state in the new frame: its pose is exact, and what was uncertain about it is so about velocity and
        gravity.
        """
        state = self.drift.hand_over(state, np.eye(POSE_DIM))
        self._window.begin()
        self._lasting.begin()
        self.map.clear()
        return state

    def pose_covariance(self, state: NavState) -> Array:
        """Return the covariance of rotation (body) and position (odom) against the odom frame's origin, (6, 6)."""
        return self.drift.pose_covariance(state)
