"""The map's file, written block by block, and the even choice of its points that pictures are drawn from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.io.files.clouds import cloud_stream
from heliograph.maps import MapPoints

__all__ = ["FinishedMap", "MapBounds", "write_map"]

_DRAWN = 6_000_000  # points that pictures are made from at most
_SINGLE = 8192.0  # coordinates larger than this are a millimetre apart, or more, in single precision [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedMap:
    """What became of a map.

    Parameters
    ----------
    count : int
        Points in the file.
    points : (N, 3) float32
        An even choice of them, all if they are not very many [m].
    intensity : (N,) float32
        Their mean intensity.
    """

    count: int = 0
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    intensity: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapBounds:
    """What must be known of a map before its first block is written.

    Parameters
    ----------
    stamps_ns : (V,) int64
        When each visit began [ns]; the points' ``first`` counts them.
    largest : float
        No coordinate is larger [m].
    brightest : float
        No intensity is.
    """

    stamps_ns: NDArray[np.int64]
    largest: float
    brightest: float

    def __post_init__(self) -> None:
        freeze(self)


def write_map(path: Path, blocks: Iterable[tuple[MapBounds, MapPoints]]) -> FinishedMap:
    """Write the blocks of a map; without one there is no file.

    The columns are ``x``, ``y``, ``z`` (double precision where the map is so large that single is coarser than half a
    millimetre), ``intensity``, and ``stamp``, when the point was first seen to one keyframe [s].

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    left = iter(blocks)
    first = next(left, None)
    if first is None:
        return FinishedMap()
    bounds, drawn, count = first[0], _Choice(), 0
    place = np.dtype(np.float32 if bounds.largest <= _SINGLE else np.float64)
    types: dict[str, np.dtype[np.generic]] = dict.fromkeys("xyz", place)
    types |= {"intensity": np.dtype(np.float32), "stamp": np.dtype(np.float64)}
    with cloud_stream(path, types, brightest=bounds.brightest) as stream:
        for _, block in chain([first], left):
            x, y, z = block.points.T
            stamp = 1e-9 * bounds.stamps_ns[block.first]
            stream.append({"x": x, "y": y, "z": z, "intensity": block.intensity, "stamp": stamp})
            drawn.add(block)
            count += len(block)
    return drawn.finished(count)


class _Choice:
    """One of every few points that come, so that the choice stays even and never grows too large."""

    def __init__(self) -> None:
        self._stride, self._next, self._held = 1, 0, 0
        self._parts: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []

    def add(self, block: MapPoints) -> None:
        some = slice(self._next, None, self._stride)
        self._parts.append((block.points[some].astype(np.float32), block.intensity[some].copy()))
        self._held += len(self._parts[-1][1])
        self._next = (self._next - len(block)) % self._stride
        while self._held > _DRAWN:
            self._parts = [self._joined(2)]
            self._held = len(self._parts[0][1])
            self._stride *= 2

    def finished(self, count: int) -> FinishedMap:
        points, intensity = self._joined(1)
        return FinishedMap(count=count, points=points, intensity=intensity)

    def _joined(self, every: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        points, intensity = (np.concatenate(parts)[::every] for parts in zip(*self._parts, strict=True))
        return np.ascontiguousarray(points), np.ascontiguousarray(intensity)
