"""Cells of a map sorted by tiles of space, on disk where they are many, so that one tile at a time is put together."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.maps import GlobalMap, MapCells, MapPoints, split_tiles

__all__ = ["MapTiles", "Tile"]

_EDGE = 512  # cubes along a tile's edge: half a million cells of a building at most
_HALO = 8  # cubes of its neighbours that a tile is put together with: more than surfaces look around
_ROOM = 400_000  # cells in memory before they go to disk
_CELL = np.dtype([("cube", "<i2", 3), ("sums", "<f4", 3), ("intensity", "<f4"), ("count", "<u2")])
_MAX_POINTS = 60_000  # points of a cell that its count holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One tile of a map, and what of its neighbours lies close to it.

    Parameters
    ----------
    index : tuple of int
        Along the axes.
    low, high : (3,) float64
        Its corners [m].
    whole : GlobalMap
        Its cells and those close to it.
    """

    index: tuple[int, int, int]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    whole: GlobalMap

    def __post_init__(self) -> None:
        freeze(self)

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points (N, 3) lie in the tile itself."""
        return np.asarray(((points >= self.low) & (points < self.high)).all(axis=1))

    def own(self, found: MapPoints) -> MapPoints:
        """Return those of the points that lie in the tile itself."""
        inside = self.holds(found.points)
        return MapPoints(points=found.points[inside], intensity=found.intensity[inside], first=found.first[inside])


@dataclass(slots=True)
class _Stock:
    """The cells of one tile: records of one visit each, and where those that went to disk lie."""

    held: list[tuple[int, NDArray[np.void]]] = field(default_factory=list)
    stored: list[tuple[int, list[tuple[int, int]]]] = field(default_factory=list)  # offset, (visit, cells) of a piece


class MapTiles:
    """Takes the cells of a map visit by visit, and gives it back tile by tile.

    A cell takes 24 bytes. What does not fit into memory goes to a file without a name, which is gone when the process
    ends, however it ends.

    Parameters
    ----------
    folder : Path
        Where that file lies.
    voxel : float
        Edge of the cubes [m].
    """

    def __init__(self, folder: Path, voxel: float) -> None:
        self._folder, self.voxel, self._room = folder, voxel, _ROOM
        self._stocks: dict[tuple[int, int, int], _Stock] = {}
        self._count = 0
        self._file: IO[bytes] | None = None
        self.largest = 0.0
        """Largest coordinate of any tile [m]."""
        self.brightest = 0.0
        """Largest mean intensity of any cell."""

    def add(self, cells: MapCells, visit: int) -> None:
        """Take the cells of one visit; each cube comes once."""
        if not len(cells):
            return
        split = split_tiles(cells.cubes + np.int32(_EDGE // 2), _EDGE, _HALO)
        self.brightest = max(self.brightest, float((cells.intensity / cells.counts).max()))
        for k, tile in enumerate(split.tiles.tolist()):
            some = split.cells[split.begin[k] : split.begin[k + 1]]
            index = (tile[0], tile[1], tile[2])
            self._stocks.setdefault(index, _Stock()).held.append((visit, _packed(cells, some, _corner(index))))
            self._count += len(some)
            self.largest = max(self.largest, self.voxel * _EDGE * (max(map(abs, index)) + 1))
        if self._count > self._room:
            self._spill()

    def __iter__(self) -> Iterator[Tile]:
        """Yield the tiles in the order in which they were reached."""
        for index, stock in self._stocks.items():
            whole, corner = GlobalMap(self.voxel), _corner(index)
            for visit, records in self._records(stock):
                whole.merge(_unpacked(records, corner), visit=visit)
            low = corner.astype(np.float64) * np.float64(self.voxel)
            high = low + np.float64(_EDGE * self.voxel)
            yield Tile(index=index, low=low, high=high, whole=whole)

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
        self._stocks.clear()

    def _spill(self) -> None:
        """Move what is held to disk; where there is no room, memory has to do."""
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - closed by `close`
            at = self._file.seek(0, 2)
            for stock in self._stocks.values():
                if not stock.held:
                    continue
                for _, records in stock.held:
                    self._file.write(records.data)
                pieces = [(visit, len(records)) for visit, records in stock.held]
                stock.stored.append((at, pieces))
                stock.held = []
                at += _CELL.itemsize * sum(count for _, count in pieces)
            self._file.flush()
            self._count = 0
        except OSError:
            self._room = 1 << 62

    def _records(self, stock: _Stock) -> Iterator[tuple[int, NDArray[np.void]]]:
        for at, parts in stock.stored:
            assert self._file is not None
            self._file.seek(at)
            for visit, count in parts:
                yield visit, np.frombuffer(self._file.read(count * _CELL.itemsize), _CELL)
        yield from stock.held


def _corner(index: tuple[int, int, int]) -> NDArray[np.int64]:
    """Return the lowest cube of a tile; the frame's origin lies in the middle of one, not where eight of them meet."""
    return np.array(index, dtype=np.int64) * _EDGE - _EDGE // 2


def _packed(cells: MapCells, some: NDArray[np.uint32], corner: NDArray[np.int64]) -> NDArray[np.void]:
    out = np.empty(len(some), dtype=_CELL)
    counts = cells.counts[some]
    share = np.minimum(1.0, _MAX_POINTS / counts).astype(np.float32)
    out["cube"] = cells.cubes[some] - corner
    out["sums"] = cells.sums[some] * share[:, None]
    out["intensity"] = cells.intensity[some] * share
    out["count"] = np.minimum(counts, _MAX_POINTS)
    return out


def _unpacked(records: NDArray[np.void], corner: NDArray[np.int64]) -> MapCells:
    return MapCells(
        cubes=(records["cube"].astype(np.int64) + corner).astype(np.int32),
        sums=np.ascontiguousarray(records["sums"], dtype=np.float32),
        intensity=np.ascontiguousarray(records["intensity"], dtype=np.float32),
        counts=records["count"].astype(np.float32),
    )
