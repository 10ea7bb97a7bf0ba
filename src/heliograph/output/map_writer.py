"""The output map while a run goes on: summed up keyframe by keyframe, put together when the poses are final."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.config import OutputConfig
from heliograph.data import ScanResult
from heliograph.errors import OutputError
from heliograph.io.prefetch import prefetch
from heliograph.lie import se3
from heliograph.maps import GlobalMap, MapCells, MapPoints, Sight
from heliograph.output.background import Background
from heliograph.output.final_poses import FinalPoses
from heliograph.output.map_file import MapBounds
from heliograph.output.moving import MAX_SIGHTS, seen_through
from heliograph.output.submaps import Submap, SubmapFile, located_submaps, read_sight
from heliograph.output.tiles import MapTiles, Tile
from heliograph.snapshots import Snapshot, array, fixed, require

__all__ = ["MapWriter"]

_STATE = {
    "size": int, "submaps": int, "keyframe": (fixed(int, array(np.float64, 4, 4)), None),
    "sight": (Sight, None), "cells": MapCells,
}  # fmt: skip
_READ_AHEAD = 2  # submaps
_MAX_RAYS = 32_768  # of a keyframe's scan


class MapWriter:
    """Sums the points between two keyframes in cubes of the odom frame, and keeps what is closed on disk.

    In memory is only what was seen since the last keyframe: of the others, poses may change until the run ends, and
    memory must not grow with it. Nor does it when the map is put together: that is done tile by tile.

    Parameters
    ----------
    path : Path
        File for the submaps.
    config : OutputConfig
        Edge of the cubes, and when a keyframe comes.
    threaded : bool
        Whether a second thread may do some of the work; the result is the same.
    earlier : Snapshot, optional
        State of an earlier run's writer, which this one goes on from.

    Raises
    ------
    DataError
        ``earlier`` is no such state.
    """

    def __init__(
        self, path: Path, config: OutputConfig, *, threaded: bool = False, earlier: Snapshot | None = None
    ) -> None:
        self._config = config
        if earlier is not None:
            require(self, earlier, _STATE)
        at, count = (None, 0) if earlier is None else (earlier["size"], earlier["submaps"])
        self._file = SubmapFile(path, config.map_voxel, at=at, count=count)
        self._open = GlobalMap(config.map_voxel)
        self._keyframe: tuple[int, NDArray[np.float64]] | None = None
        self._sight: Sight | None = None
        self._full = self._released = False
        self._threads = 2 if threaded else 1
        self._background = Background(threaded=threaded)
        self.dropped = 0
        """How many cubes `blocks` left out because what was there moved."""
        if earlier is not None:
            self._keyframe, self._sight = earlier["keyframe"], earlier["sight"]
            self._open.merge(earlier["cells"])

    def snapshot(self) -> Snapshot:
        """Return what the next scans are added to, and the size of the file, which is on the disk."""
        self._background.wait()
        self._file.settle()
        return {
            "size": self._file.nbytes, "submaps": self._file.count, "keyframe": self._keyframe,
            "sight": self._sight, "cells": self._open.cells(),
        }  # fmt: skip

    @property
    def path(self) -> Path:
        """The file of submaps."""
        return self._file.path

    @property
    def submaps(self) -> int:
        """How many submaps lie on disk."""
        return self._file.count

    @property
    def nbytes(self) -> int:
        """Memory that the points since the last keyframe take [bytes]."""
        return self._open.nbytes

    def add(self, result: ScanResult) -> None:
        """Add a scan's points, from its pose in odom."""
        self._background.do(lambda: self._add(result))

    def blocks(self, final: FinalPoses) -> Iterator[tuple[MapBounds, MapPoints]]:
        """Put the map together, tile by tile; memory holds one of them.

        Parameters
        ----------
        final : FinalPoses
            Where the keyframes lie after all.

        Yields
        ------
        MapBounds
            Bounds of the whole map, the same each time.
        MapPoints
            The surfaces' points of a tile in the map frame, without those of what moved; without
            `OutputConfig.surface_thickness` the mean of each cube.
        """
        self._background.wait()
        rigid = final.rigid
        tiles, stamps, where = MapTiles(self.path.parent, self._config.map_voxel), [], []
        try:
            for number, (at, submap) in enumerate(self._submaps()):
                moved = final.T_map_odom(np.array([submap.stamp_ns]))[0] if rigid is None else None
                tiles.add(submap.cells if moved is None else self._moved(submap.cells, moved), number)
                stamps.append(submap.stamp_ns)
                where.append(_Seen.of(submap, at, moved))
            reach = 0.0 if rigid is None else float(np.abs(rigid[:3, 3]).max())
            bounds = MapBounds(
                stamps_ns=np.array(stamps, dtype=np.int64), largest=tiles.largest + reach, brightest=tiles.brightest
            )
            self.dropped = 0
            for tile in tiles:
                found = self._finished(tile, [seen for seen in where if seen is not None])
                if len(found):
                    yield bounds, found if rigid is None else _turned(found, rigid)
        finally:
            tiles.close()

    def points(self, final: FinalPoses) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return all points of `blocks` and their intensity at once."""
        blocks = [block for _, block in self.blocks(final)]
        points = np.concatenate([np.zeros((0, 3)), *(block.points for block in blocks)])
        intensity = np.concatenate([np.zeros(0, np.float32), *(block.intensity for block in blocks)])
        return points.astype(np.float32), intensity

    def release(self, *, keep: bool) -> bool:
        """Let go of the file: with ``keep`` it stays, and the points since the last keyframe are added to it.

        Returns
        -------
        bool
            Whether the file stays. A second call changes nothing and returns False.
        """
        if self._released:
            return False
        self._released = True
        self._background.close()
        try:
            if keep:
                self._close_submap()
        finally:
            self._file.close()
            if not keep:
                self.path.unlink(missing_ok=True)
        return keep

    def _moved(self, cells: MapCells, T_map_odom: NDArray[np.float64]) -> MapCells:
        """Return cells of a submap by the cubes in which they come to lie."""
        moved = GlobalMap(self._config.map_voxel)
        moved.merge(cells, T_map_odom)
        return moved.cells()

    def _finished(self, tile: Tile, seen: list[_Seen]) -> MapPoints:
        """Return the points of a tile."""
        if self._config.drop_moving:
            gone = seen_through(tile.whole, self._sights(tile, seen), self._config)
            if gone.any():
                self.dropped += int(np.count_nonzero(tile.holds(tile.whole.means()[gone])))
                tile.whole.keep(~gone)
        return tile.own(tile.whole.averaged(self._config.surface_thickness, threads=self._threads))

    def _sights(self, tile: Tile, seen: list[_Seen]) -> list[Sight]:
        """Return what the scans near a tile saw, an even choice where there are very many."""
        if not seen:
            return []
        origins = np.array([one.origin for one in seen])
        apart = np.linalg.norm(origins - np.clip(origins, tile.low, tile.high), axis=1)
        near = np.flatnonzero(apart <= self._config.moving_reach)
        chosen = near[:: -(-len(near) // MAX_SIGHTS) or 1]
        return [seen[k].sight(self.path) for k in chosen.tolist()]

    def _add(self, result: ScanResult) -> None:
        try:
            if self._keyframe is None or self._is_keyframe(*self._keyframe, result):
                self._close_submap()
                self._keyframe, self._sight = (result.end_ns, result.T_odom_imu), self._rays(result)
        finally:
            self._open.insert(result.points_imu, result.intensity, result.T_odom_imu)

    def _rays(self, result: ScanResult) -> Sight | None:
        """Return where a scan's rays ended, an even choice of very many."""
        if not self._config.drop_moving:
            return None
        points = result.points_imu[:: -(-len(result.points_imu) // _MAX_RAYS) or 1]
        lever, T = result.T_imu_lidar[:3, 3], result.T_odom_imu
        path = result.path
        T_start = path.T_frame_body[int(np.clip(np.searchsorted(path.stamps_ns, result.stamp_ns), 0, len(path) - 1))]
        points = points[np.isfinite(points).all(axis=1)]
        ends = (points - lever.astype(np.float32)) @ T[:3, :3].T.astype(np.float32)
        return Sight(
            origin=T[:3, :3] @ lever + T[:3, 3],
            start=T_start[:3, :3] @ lever + T_start[:3, 3],
            ends=np.ascontiguousarray(ends),
        )

    def _is_keyframe(self, stamp_ns: int, T_odom_imu: NDArray[np.float64], result: ScanResult) -> bool:
        config, turn = self._config, se3.local(T_odom_imu, result.T_odom_imu)[:3]
        return not self._full and bool(
            np.linalg.norm(result.T_odom_imu[:3, 3] - T_odom_imu[:3, 3]) >= config.keyframe_distance
            or np.linalg.norm(turn) >= math.radians(config.keyframe_angle_deg)
            or result.end_ns - stamp_ns >= 1e9 * config.keyframe_interval
        )

    def _close_submap(self) -> None:
        if self._keyframe is None or not len(self._open):
            return
        try:
            self._file.append(self._unfinished(self._keyframe))
        except OutputError:
            self._full = True  # what is in memory stays there, and the map is put together with it
            raise
        self._open.clear()

    def _submaps(self) -> Iterator[tuple[int, Submap]]:
        """Yield those on disk with their place there, then what has come since."""
        # With a second thread the next one is read while this one is merged.
        on_disk = located_submaps(self.path)
        yield from on_disk if self._threads == 1 else prefetch(on_disk, _READ_AHEAD)
        if self._keyframe is not None:
            yield -1, self._unfinished(self._keyframe)

    def _unfinished(self, keyframe: tuple[int, NDArray[np.float64]]) -> Submap:
        return Submap(stamp_ns=keyframe[0], T_odom_imu=keyframe[1], cells=self._open.cells(), sight=self._sight)


@dataclass(frozen=True, slots=True)
class _Seen:
    """Where what a submap's keyframe saw is found again."""

    at: int  # in the file; -1: it is `held`
    held: Sight | None
    origin: NDArray[np.float64]
    T_map_odom: NDArray[np.float64] | None

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, submap: Submap, at: int, T_map_odom: NDArray[np.float64] | None) -> _Seen | None:
        if submap.sight is None:
            return None
        origin = submap.sight.origin
        if T_map_odom is not None:
            origin = T_map_odom[:3, :3] @ origin + T_map_odom[:3, 3]
        return cls(at=at, held=submap.sight if at < 0 else None, origin=origin, T_map_odom=T_map_odom)

    def sight(self, path: Path) -> Sight:
        found = self.held if self.held is not None else read_sight(path, self.at)
        assert found is not None
        return found if self.T_map_odom is None else found.moved(self.T_map_odom)


def _turned(found: MapPoints, T: NDArray[np.float64]) -> MapPoints:
    if np.array_equal(T, np.eye(4)):
        return found
    return MapPoints(points=se3.act(T, found.points), intensity=found.intensity, first=found.first)
