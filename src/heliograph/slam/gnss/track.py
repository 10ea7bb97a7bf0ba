"""The way of the body by the odometry, scan by scan: where it was when a fix was taken."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, Stamps
from heliograph.lie import interpolate_se3, se3
from heliograph.snapshots import Stateful, array

__all__ = ["OdometryTrack"]

_LONGEST_NS = 500_000_000  # between two scans, nothing is interpolated across a longer gap


class OdometryTrack(Stateful):
    """Poses of all matched scans, in order."""

    _STATE: ClassVar = {
        "_stamps": [int],
        "_poses": [array(np.float64, 4, 4)],
    }

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[Array] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, stamp_ns: int, T_odom_imu: Array) -> None:
        """Add a scan's time [ns] and pose (4, 4); one that is not later than the last is left out."""
        if not self._stamps or stamp_ns > self._stamps[-1]:
            self._stamps.append(stamp_ns)
            self._poses.append(np.asarray(T_odom_imu))

    @property
    def last_ns(self) -> int:
        """Time of the last scan, 0 before the first [ns]."""
        return self._stamps[-1] if self._stamps else 0

    @property
    def first_ns(self) -> int:
        """Time of the first scan, 0 before it [ns]."""
        return self._stamps[0] if self._stamps else 0

    def poses(self, times_ns: Stamps) -> tuple[Array, Mask]:
        """Return ``T_odom_imu`` (N, 4, 4) at some times (N,), and a mask (N,) of those that scans lie close around."""
        stamps, poses = np.array(self._stamps, dtype=np.int64), np.stack(self._poses)
        after = np.clip(np.searchsorted(stamps, times_ns), 1, max(len(stamps) - 1, 1))
        covered = (times_ns >= stamps[0]) & (times_ns <= stamps[-1])
        if len(stamps) > 1:
            covered &= stamps[after] - stamps[after - 1] <= _LONGEST_NS
        inside = np.clip(times_ns, stamps[0], stamps[-1])
        return interpolate_se3(stamps, poses, inside), covered

    def at_keyframes(
        self, times_ns: Stamps, keyframes_ns: Stamps, T_odom_keyframes: Array
    ) -> tuple[NDArray[np.int64], Array, Mask]:
        """Return the nearest keyframes (N,) of some times, ``T_keyframe_body`` (N, 4, 4) and who is covered (N,)."""
        T, covered = self.poses(times_ns)
        right = np.clip(np.searchsorted(keyframes_ns, times_ns), 0, len(keyframes_ns) - 1)
        left = np.maximum(right - 1, 0)
        nearest = np.where(times_ns - keyframes_ns[left] < keyframes_ns[right] - times_ns, left, right)
        return nearest, se3.compose(se3.inverse(T_odom_keyframes[nearest]), T), covered
