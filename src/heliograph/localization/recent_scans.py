"""The scans of the last metres, joined by odometry: what is looked for in a map."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, Points, freeze
from heliograph.cloud import voxel_downsample
from heliograph.config import LocalizationConfig
from heliograph.data import ScanResult
from heliograph.lie import se3
from heliograph.maps import transformed
from heliograph.slam.places import level_pose

__all__ = ["RecentScans", "level_frame"]

_THINNED = 0.2  # edge of the cubes of which each scan keeps a point [m]
_TURN = np.radians(10.0)  # a turn that shows as much that is new as half a metre


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kept:
    T_odom_imu: Array
    points_imu: Points
    way: float

    def __post_init__(self) -> None:
        freeze(self)


class RecentScans:
    """Some of the latest scans, and the time and way since the last query.

    Parameters
    ----------
    config : LocalizationConfig
    """

    def __init__(self, config: LocalizationConfig) -> None:
        self._config = config
        self._kept: deque[_Kept] = deque()
        self._way = 0.0
        self._last: Array | None = None
        self._asked: tuple[int, Array] | None = None

    def clear(self) -> None:
        """Forget them: odometry no longer knows how they lie to each other."""
        self._kept.clear()
        self._asked = None

    def add(self, result: ScanResult) -> None:
        """Take a scan."""
        T = result.T_odom_imu
        if self._last is not None:
            self._way += float(np.linalg.norm(T[:3, 3] - self._last[:3, 3]))
        self._last = T
        if self._kept and not _moved(self._kept[-1].T_odom_imu, T, self._config.every):
            return
        points = result.points_imu[voxel_downsample(result.points_imu, _THINNED)]
        self._kept.append(_Kept(T_odom_imu=T, points_imu=points, way=self._way))
        while self._way - self._kept[0].way > self._config.before:
            self._kept.popleft()

    @property
    def latest(self) -> Points:
        """The last scan's points, thinned (N, 3), imu frame [m]."""
        return self._kept[-1].points_imu

    def due(self, result: ScanResult) -> bool:
        """Whether it is time for a query; it then counts as asked."""
        if self._asked is not None:
            at_ns, T = self._asked
            if result.end_ns - at_ns < 1e9 * self._config.every_s and not _moved(
                T, result.T_odom_imu, self._config.every
            ):
                return False
        self._asked = result.end_ns, result.T_odom_imu
        return True

    def joined(self, T_odom_level: Array) -> Points:
        """Return their points (N, 3) in a levelled frame."""
        T_level_odom = se3.inverse(T_odom_level)
        parts = [transformed(kept.points_imu, T_level_odom @ kept.T_odom_imu) for kept in self._kept]
        return np.ascontiguousarray(np.concatenate(parts), dtype=np.float32) if parts else np.zeros((0, 3), np.float32)


def level_frame(T_frame_imu: Array) -> Array:
    """Return the levelled frame of a body, ``T_frame_level`` (4, 4): its origin and heading, z up."""
    T = np.ascontiguousarray(T_frame_imu)
    return np.ascontiguousarray(T @ se3.inverse(level_pose(T)))


def _moved(A: Array, B: Array, distance: float) -> bool:
    turned = float(np.trace(A[:3, :3].T @ B[:3, :3])) < 1.0 + 2.0 * np.cos(_TURN)
    return turned or float(np.linalg.norm(A[:3, 3] - B[:3, 3])) >= distance
