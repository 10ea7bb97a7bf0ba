"""A query placed in submaps at every heading, by correlating what stands upright in both, seen from above.

A detector's ranking by what does not change under turns and shifts fails where a query saw a part of its surroundings
only: a narrow field of view, the first scan. Correlation does not mind what else the submap holds, and at a coarse
resolution all headings of some ten submaps cost a few hundredths of a second: eq. (1) of docs/theory/localization.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points
from heliograph.lie import se3, so3

__all__ = ["HeadingSearch"]

_CELL = 1.0  # of the picture [m]: registration pulls in what is a cell off
_SIZE = 48  # cells along a side
_PADDED = 72  # shifts up to half a side do not wrap around
_HEADINGS = 60
_LAYER, _LAYERS = 0.25, 64  # of the height profile [m]
_UPRIGHT = 3  # layers occupied in a cell that holds a wall: floors and ceilings do not
_PEAKS = 4  # places kept of a submap
_LEAST = 0.75  # share of the submap's highest peak below which none is kept
_LOOKED_AT = 200  # highest values that are looked through for peaks
_APART, _APART_HEADINGS = 1.5, 2  # peaks no further apart than this are one [cells], [headings]

Floats = NDArray[np.float32]


class HeadingSearch:
    """Pictures of submaps from above, made when they are first asked for, and the search through them.

    Parameters
    ----------
    clouds : sequence of (N, 3) float32
        Points of the submaps, each in its own frame, z up [m].
    """

    def __init__(self, clouds: Sequence[Points]) -> None:
        self._clouds = clouds
        self._pictures: dict[int, tuple[NDArray[np.complex64], Floats]] = {}

    def places(self, points_level: Points, indices: Sequence[int]) -> Iterator[tuple[int, Array]]:
        """Yield submap and guess ``T_submap_level`` (4, 4) of a query's points (N, 3), levelled, in the submaps asked.

        Parameters
        ----------
        points_level : (N, 3) float32
            z up, the origin at the IMU [m].
        indices : sequence of int
            Numbers of the submaps.
        """
        cells, heights = _seen_from_above(points_level)
        if len(cells) == 0:
            return
        turned = np.conj(np.fft.rfft2(_turned(cells)))
        for index in indices:
            image, profile = self._picture(index)
            correlation = np.fft.irfft2(image * turned, s=(_PADDED, _PADDED))
            z = _LAYER * _lift(profile, heights)
            for T in _peaks(correlation, z):
                yield index, T

    def _picture(self, index: int) -> tuple[NDArray[np.complex64], Floats]:
        if index not in self._pictures:
            cells, heights = _seen_from_above(self._clouds[index])
            picture = np.zeros((_PADDED, _PADDED), dtype=np.float32)
            picture[tuple((cells + _SIZE // 2).astype(np.int64).T)] = 1.0
            self._pictures[index] = np.fft.rfft2(_spread(picture)).astype(np.complex64), heights
        return self._pictures[index]


def _seen_from_above(points_level: Points) -> tuple[Array, Floats]:
    """Return the cells that hold something upright (K, 2), from the middle, and the profile of heights."""
    cells = np.floor(points_level[:, :2] / np.float32(_CELL)).astype(np.int64)
    layer = np.floor(points_level[:, 2] / np.float32(_LAYER)).astype(np.int64) + _LAYERS // 2
    half = _SIZE // 2
    inside = (cells >= -half).all(axis=1) & (cells < half).all(axis=1) & (layer >= 0) & (layer < _LAYERS)
    keys = (cells[inside] + half) @ np.array([_SIZE, 1])
    solid = np.zeros((_SIZE * _SIZE, _LAYERS), dtype=bool)
    solid[keys, layer[inside]] = True
    upright = np.flatnonzero(solid.sum(axis=1) >= _UPRIGHT)
    heights = np.sqrt(solid.sum(axis=0).astype(np.float32))
    return np.column_stack(np.divmod(upright, _SIZE)) - half, heights


def _turned(cells: Array) -> Floats:
    """Return the query's picture at every heading, (headings, padded, padded)."""
    angles = 2.0 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = (cells + 0.5).T
    at = np.floor(np.stack([c * x - s * y, s * x + c * y], axis=-1)).astype(np.int64) + _SIZE // 2
    heading, cell = np.nonzero((at >= 0).all(axis=-1) & (at < _SIZE).all(axis=-1))
    out = np.zeros((_HEADINGS, _PADDED, _PADDED), dtype=np.float32)
    out[heading, at[heading, cell, 0], at[heading, cell, 1]] = 1.0
    return out


def _spread(picture: Floats) -> Floats:
    """Give half a point to the four neighbours of occupied cells: a wall may lie on the other side of a cell's edge."""
    beside = np.max([np.roll(picture, step, axis) for axis in (0, 1) for step in (-1, 1)], axis=0)
    return np.asarray(np.maximum(picture, np.float32(0.5) * beside), dtype=np.float32)


def _lift(submap: Floats, query: Floats) -> int:
    """Return by how many layers the query is raised where its profile of heights fits the submap's best."""
    products = np.correlate(submap - submap.mean(), query - query.mean(), mode="full")
    return int(np.argmax(products)) - (len(query) - 1)


def _peaks(correlation: Array, z: float) -> Iterator[Array]:
    """Yield the poses of the highest values, no two of them the same place."""
    values = correlation.ravel()
    highest = np.argpartition(values, -_LOOKED_AT)[-_LOOKED_AT:]
    highest = highest[np.argsort(-values[highest], kind="stable")]
    highest = highest[values[highest] >= _LEAST * values[highest[0]]]
    heading, dx, dy = np.array(np.unravel_index(highest, correlation.shape))
    at = np.column_stack([np.array([dx, dy]).T, heading])
    at[:, :2] = (at[:, :2] + _PADDED // 2) % _PADDED - _PADDED // 2
    for _ in range(_PEAKS):
        if len(at) == 0:
            return
        off = np.abs(at - at[0])
        off[:, 2] = np.minimum(off[:, 2], _HEADINGS - off[:, 2])
        turn = so3.from_rpy(0.0, 0.0, 2.0 * np.pi * float(at[0, 2]) / _HEADINGS)
        yield se3.from_rotation_translation(turn, np.array([*(_CELL * at[0, :2]), z]))
        at = at[(np.hypot(off[:, 0], off[:, 1]) > _APART) | (off[:, 2] > _APART_HEADINGS)]
