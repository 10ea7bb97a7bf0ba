"""Local maps of keyframes: what is matched when two places are compared."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from typing import Protocol, runtime_checkable

import numpy as np

from heliograph.arrays import Array, Points
from heliograph.config import AlignConfig
from heliograph.lie import se3
from heliograph.maps import transformed
from heliograph.registration import PreparedCloud, prepare_cloud

__all__ = ["LocalMaps", "Submaps", "local_map"]


@runtime_checkable
class Submaps(Protocol):
    """Where the clouds and poses of keyframes come from, such as the store of a run."""

    def points(self, index: int) -> Points:
        """Return a keyframe's cloud (N, 3) float32 in its body frame [m]."""
        ...

    def T_odom_imu(self, index: int) -> Array:
        """Return a keyframe's pose (4, 4)."""
        ...


def local_map(submaps: Submaps, centre: int, members: Iterable[int]) -> Points:
    """Return the clouds of some keyframes in the body frame of one of them, (N, 3) float32."""
    T_centre_odom = se3.inverse(submaps.T_odom_imu(centre))
    parts = []
    for index in members:
        parts.append(transformed(submaps.points(index), T_centre_odom @ submaps.T_odom_imu(index)))
    return np.ascontiguousarray(np.concatenate(parts), dtype=np.float32) if parts else np.zeros((0, 3), np.float32)


class LocalMaps:
    """Local maps around keyframes, prepared for registration; the latest used are kept.

    Parameters
    ----------
    submaps : Submaps
    config : AlignConfig
        What they are prepared with. With ``one_sided`` a surface shows the side that the map's centre sees: the ceiling
        of a storey is not the floor of the next.
    kept : int
        Number of maps kept.
    """

    def __init__(self, submaps: Submaps, config: AlignConfig, *, kept: int = 16) -> None:
        self.submaps, self.config = submaps, config
        self._kept = kept
        self._maps: OrderedDict[tuple[int, int, int], PreparedCloud | None] = OrderedDict()  # None: made when asked for

    def around(self, centre: int, first: int, last: int) -> PreparedCloud:
        """Return the map of keyframes ``first`` to ``last`` (both included) in the body frame of ``centre``."""
        key = (centre, first, last)
        found = self._maps.get(key)
        if found is None:
            points = local_map(self.submaps, centre, range(first, last + 1))
            found = self._maps[key] = prepare_cloud(points, self.config, name=f"local map of keyframe {centre}")
        self._maps.move_to_end(key)
        while len(self._maps) > self._kept:
            self._maps.popitem(last=False)
        return found

    @property
    def held(self) -> list[tuple[int, int, int]]:
        """Centre, first and last keyframe of each map that is there, those that were not asked for longest first."""
        return list(self._maps)

    def hold(self, maps: Iterable[tuple[int, int, int]]) -> None:
        """Have these maps and no others, as `held` names them: each is made when it is asked for."""
        self._maps = OrderedDict((key, None) for key in maps)

    def holds(self, centre: int, first: int, last: int) -> bool:
        """Whether a map is there already."""
        return (centre, first, last) in self._maps

    def clear(self) -> None:
        """Forget the maps: poses have moved."""
        self._maps.clear()
