"""The same-wall test while a run goes on: how thick large static planes come out, in calm, in turns, near and far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.data import ScanResult
from heliograph.snapshots import Stateful, array, fixed

__all__ = ["SurfaceWatch", "Thickness"]

_EVERY = 3  # scans: the others show the same walls
_POINTS = 500  # of a scan
_EDGE = 0.5  # of the cubes that a wall is cut into [m]
_SHIFT = (0.13, 0.21, 0.17)  # of the grid: walls at round numbers lie inside the cubes, not on their borders [m]
_WINDOW_S, _WINDOW_M = 20.0, 30.0  # the odometry's own drift over more is no smear [s], [m]
_MIN_POINTS, _MIN_CUBES = 25, 12
_MIN_SPREAD = 0.1  # of a cube's points across the wall's plane, standard deviation along its shorter side [m]
_CLEAN_QUANTILE = 0.25  # cubes with an edge, a chair or a leaf in them are thick whatever the run: the cleanest tell
_FULL_CHORD = np.sqrt(8.0)  # Frobenius norm of the difference between two rotations half a turn apart
_TURNING, _FAR = 0.4, 8.0  # rate of the body [rad/s], range of a point [m]
_INDEX_BITS, _INDEX_MASK = 21, (1 << 21) - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Thickness:
    """How thick planes came out in one window.

    Parameters
    ----------
    whole : float
        Standard deviation of the points across a clean wall [m].
    calm, turning, near, far : float
        The same of the points seen so; NaN where too few were [m].
    cubes : int
        Pieces of wall looked at.
    stamp_ns : int
        The window's end [ns].
    speed : float
        Mean speed [m/s].
    """

    whole: float
    calm: float
    turning: float
    near: float
    far: float
    cubes: int
    stamp_ns: int
    speed: float


class SurfaceWatch(Stateful):
    """Gathers a few points of every third scan and measures the walls that they lie on, window by window."""

    _STATE: ClassVar = {
        "windows": [Thickness],
        "_points": [array(np.float64, None, 3)],
        "_classes": [array(np.int64, None)],
        "_begin": (fixed(int, array(np.float64, 3)), None),
        "_previous": (ScanResult, None),
        "_way": float,
    }

    def __init__(self) -> None:
        self.windows: list[Thickness] = []
        self._points: list[Array] = []
        self._classes: list[NDArray[np.int64]] = []
        self._begin: tuple[int, Array] | None = None
        self._previous: ScanResult | None = None
        self._way = 0.0

    def add(self, result: ScanResult) -> None:
        """Take in one scan's result."""
        before, self._previous = self._previous, result
        if before is None or not result.matched or result.index % _EVERY or not len(result.points_imu):
            return
        seconds = (result.end_ns - before.end_ns) * 1e-9
        if seconds <= 0.0:
            return
        position = result.T_odom_imu[:3, 3]
        if self._begin is None:
            self._begin = (result.end_ns, position.copy())
        chord = float(np.linalg.norm(result.T_odom_imu[:3, :3] - before.T_odom_imu[:3, :3]))
        turning = 2.0 * float(np.arcsin(min(chord / _FULL_CHORD, 1.0))) / seconds > _TURNING
        picked = result.points_imu[:: max(1, len(result.points_imu) // _POINTS)].astype(np.float64)
        far = np.einsum("ij,ij->i", picked, picked) > _FAR**2
        self._points.append(picked @ result.T_odom_imu[:3, :3].T + position)
        self._classes.append(2 * int(turning) + far.astype(np.int64))
        self._way += float(np.linalg.norm(position - before.T_odom_imu[:3, 3])) * _EVERY
        begin_ns, start = self._begin
        if (result.end_ns - begin_ns) * 1e-9 > _WINDOW_S or float(np.linalg.norm(position - start)) > _WINDOW_M:
            self.close()

    def close(self) -> None:
        """End the window, also one that is short."""
        if self._begin is not None and self._previous is not None and self._points:
            points, classes = np.concatenate(self._points), np.concatenate(self._classes)
            whole, cubes = _thickness(points)
            if np.isfinite(whole):
                turning, far = classes >= 2, classes % 2 == 1
                parts = [_thickness(points[part])[0] for part in (~turning, turning, ~far, far)]
                seconds = max((self._previous.end_ns - self._begin[0]) * 1e-9, 1e-9)
                self.windows.append(
                    Thickness(
                        whole=whole, calm=parts[0], turning=parts[1], near=parts[2], far=parts[3], cubes=cubes,
                        stamp_ns=self._previous.end_ns, speed=self._way / seconds,
                    )
                )  # fmt: skip
        self._points, self._classes, self._begin, self._way = [], [], None, 0.0


def _thickness(points: Array) -> tuple[float, int]:
    """Return the standard deviation across clean pieces of wall [m], NaN for too few, and the number of pieces."""
    if len(points) < _MIN_POINTS * _MIN_CUBES:
        return float("nan"), 0
    points = points + _SHIFT
    cell = np.floor(points / _EDGE).astype(np.int64)
    packed = cell & _INDEX_MASK
    key = (packed[:, 0] << 2 * _INDEX_BITS) | (packed[:, 1] << _INDEX_BITS) | packed[:, 2]
    _, index, counts = np.unique(key, return_inverse=True, return_counts=True)
    enough = counts >= _MIN_POINTS
    local = points - (cell + 0.5) * _EDGE
    mean = np.stack([np.bincount(index, local[:, i]) for i in range(3)], axis=1) / counts[:, None]
    S = np.empty((len(counts), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            S[:, i, j] = S[:, j, i] = np.bincount(index, local[:, i] * local[:, j]) / counts - mean[:, i] * mean[:, j]
    values, vectors = np.linalg.eigh(S[enough])
    wall = values[:, 1] > _MIN_SPREAD**2
    if np.count_nonzero(wall) < _MIN_CUBES:
        return float("nan"), int(np.count_nonzero(wall))
    thick = np.sqrt(np.maximum(values[wall, 0], 0.0))
    # A wrong heading smears walls and leaves the floor alone: the way that walls face which is worst counts. A few
    # cubes that face one way may all be clutter: they tell nothing.
    facing = np.abs(vectors[wall, :, 0]).argmax(axis=1)
    kinds = [thick[facing == axis] for axis in range(3)]
    cleanest = [float(np.quantile(kind, _CLEAN_QUANTILE)) for kind in kinds if len(kind) >= _MIN_CUBES]
    return max(cleanest, default=float("nan")), len(thick)
