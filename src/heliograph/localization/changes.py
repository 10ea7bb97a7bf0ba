"""What has changed since a map was made: surfaces of it that scans see through, and new ones in front of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points, freeze
from heliograph.lie import se3
from heliograph.localization.saved_map import SavedMap
from heliograph.maps import transformed

__all__ = ["ChangeWatch", "Changes", "SubmapChange"]

_CELL = np.radians(2.0)  # of directions
_NEAR = 15.0  # surfaces farther away are not judged [m]
_FREE = 0.4  # a surface is in front of another from this distance on [m]
_SAME = 0.25  # and the same up to this one [m]
_LOOKS = 3  # looks that must agree
_EDGE = 0.2  # cubes in which new points are counted [m]
_NONE = np.float32(1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class SubmapChange:
    """How much of a submap has changed.

    Parameters
    ----------
    index : int
        Number of the submap.
    position : (3,) float64
        Its middle in the map [m].
    looked_at : int
        Surfaces of it that scans have looked at, often enough to tell.
    gone : float
        Share of those that are not there any more.
    """

    index: int
    position: Array
    looked_at: int
    gone: float

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """All that has changed, as far as scans have looked.

    Parameters
    ----------
    gone, new : (N, 3) float32
        Points of the map that are seen through, and points where it has none, map frame [m].
    submaps : tuple of SubmapChange
        Those that were looked at.
    """

    gone: NDArray[np.float32]
    new: NDArray[np.float32]
    submaps: tuple[SubmapChange, ...]

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(slots=True)
class _Account:
    """Surfaces of one submap (N, 3), and how often each was seen, and seen through."""

    means: Points
    seen: NDArray[np.int32]
    through: NDArray[np.int32]


class ChangeWatch:
    """Compares scans with the map at the place where they are known to be, direction by direction.

    A surface of the map is seen through where the scan's nearest return, in its direction and those beside it, lies
    clearly behind it; a return is new where the map's nearest surface lies clearly behind it. What one look says does
    not count: somebody walks past.

    Parameters
    ----------
    saved : SavedMap
    """

    def __init__(self, saved: SavedMap) -> None:
        self._saved = saved
        self._accounts: dict[int, _Account] = {}
        self._new: dict[tuple[int, int, int], int] = {}

    def look(self, T_map_imu: Array, points_imu: Points) -> None:
        """Take a scan (N, 3) [m] at its pose."""
        index = self._saved.nearest_index(T_map_imu)
        submap = self._saved.submaps[index]
        account = self._accounts.get(index)
        if account is None:
            means = np.ascontiguousarray(submap.cloud.native.elements(0)[0], dtype=np.float32)
            count = len(means)
            account = _Account(means, np.zeros(count, np.int32), np.zeros(count, np.int32))
            self._accounts[index] = account
        there = transformed(account.means, se3.inverse(T_map_imu) @ submap.T_map_submap)
        scan, world = _view(points_imu), _view(there)
        nearest, farthest = _surround(_image(*scan, np.minimum), np.minimum), _image(*scan, np.maximum)
        cells, ranges = world
        near = ranges < _NEAR
        through = near & (nearest.ravel()[cells] < _NONE) & (nearest.ravel()[cells] > ranges + _FREE)
        own = _image(*scan, np.minimum).ravel()[cells]
        seen = near & (own <= ranges + _SAME) & (farthest.ravel()[cells] >= ranges - _SAME)
        account.through += through
        account.seen += seen
        behind = _surround(_image(*world, np.minimum), np.minimum).ravel()[scan[0]]
        fresh = (scan[1] < _NEAR) & (behind < _NONE) & (scan[1] < behind - _FREE)
        where = transformed(np.ascontiguousarray(points_imu[fresh]), T_map_imu)
        for cube in {tuple(row) for row in np.floor(where / np.float32(_EDGE)).astype(int).tolist()}:
            self._new[cube] = self._new.get(cube, 0) + 1

    def changes(self) -> Changes:
        """Return what enough looks agree about."""
        gone, rows = [np.zeros((0, 3), np.float32)], []
        for index in sorted(self._accounts):
            account, submap = self._accounts[index], self._saved.submaps[index]
            told = np.maximum(account.seen, account.through) >= _LOOKS
            left = told & (account.through >= _LOOKS) & (account.through > 2 * account.seen)
            if not told.any():
                continue
            gone.append(transformed(np.ascontiguousarray(account.means[left]), submap.T_map_submap))
            share = float(left.sum() / told.sum())
            position = submap.T_map_submap[:3, 3].copy()
            rows.append(SubmapChange(index=index, position=position, looked_at=int(told.sum()), gone=share))
        cubes = sorted(cube for cube, count in self._new.items() if count >= _LOOKS)
        new = ((np.array(cubes, dtype=np.float64).reshape(-1, 3) + 0.5) * _EDGE).astype(np.float32)
        if len(new):  # a surface that the map has there was hidden from the submap's middle
            new = new[self._saved.surfaces.planes_at(new.astype(np.float64), gate=_SAME).source == 0]
        return Changes(gone=np.concatenate(gone), new=new, submaps=tuple(rows))


def _shape() -> tuple[int, int]:
    return round(2.0 * np.pi / _CELL), round(np.pi / _CELL)


def _view(points: Points) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return direction cell and range of each point."""
    around, up = _shape()
    x, y, z = points.T
    level = np.hypot(x, y)
    a = np.floor((np.arctan2(y, x) + np.pi) / _CELL).astype(np.int64) % around
    e = np.clip(np.floor((np.arctan2(z, level) + 0.5 * np.pi) / _CELL).astype(np.int64), 0, up - 1)
    return a * up + e, np.hypot(level, z)


def _image(cells: NDArray[np.int64], ranges: NDArray[np.float32], which: np.ufunc) -> NDArray[np.float32]:
    """Return the nearest or the farthest range by direction; where there is none, something that no range is."""
    empty = _NONE if which is np.minimum else np.float32(-1.0)
    image = np.full(_shape(), empty, dtype=np.float32)
    which.at(image.reshape(-1), cells, ranges)
    return image


def _surround(image: NDArray[np.float32], which: np.ufunc) -> NDArray[np.float32]:
    """Return the same with each cell's neighbours taken in; the image is round about the vertical."""
    out = which(which(image, np.roll(image, 1, axis=0)), np.roll(image, -1, axis=0))
    wide: NDArray[np.float32] = np.array(out, dtype=np.float32)
    wide[:, 1:] = which(wide[:, 1:], out[:, :-1])
    wide[:, :-1] = which(wide[:, :-1], out[:, 1:])
    return wide
