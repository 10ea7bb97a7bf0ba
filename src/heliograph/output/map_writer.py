"""The output map while a run goes on: summed up keyframe by keyframe, put together when the poses are final."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.config import OutputConfig
from heliograph.data import ScanResult
from heliograph.errors import OutputError
from heliograph.io.prefetch import prefetch
from heliograph.lie import se3
from heliograph.maps import GlobalMap, MapCells, transformed
from heliograph.output.background import Background
from heliograph.output.final_poses import FinalPoses
from heliograph.output.submaps import Submap, SubmapFile, read_submaps
from heliograph.snapshots import Snapshot, array, fixed, require

__all__ = ["MapWriter"]

_STATE = {
    "size": int, "submaps": int, "keyframe": (fixed(int, array(np.float64, 4, 4)), None), "cells": MapCells,
}  # fmt: skip
_READ_AHEAD = 2  # submaps


class MapWriter:
    """Sums the points between two keyframes in cubes of the odom frame, and keeps what is closed on disk.

    In memory is only what was seen since the last keyframe: of the others, poses may change until the run ends, and
    memory must not grow with it.

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
        self._full = self._released = False
        self._threads = 2 if threaded else 1
        self._background = Background(threaded=threaded)
        if earlier is not None:
            self._keyframe = earlier["keyframe"]
            self._open.merge(earlier["cells"])

    def snapshot(self) -> Snapshot:
        """Return what the next scans are added to, and the size of the file, which is on the disk."""
        self._background.wait()
        self._file.settle()
        return {
            "size": self._file.nbytes, "submaps": self._file.count, "keyframe": self._keyframe,
            "cells": self._open.cells(),
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

    def points(self, final: FinalPoses) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Put the map together.

        Parameters
        ----------
        final : FinalPoses
            Where the keyframes lie after all.

        Returns
        -------
        points_map : (N, 3) float32
            The surfaces' points [m]; without `OutputConfig.surface_thickness` the mean of each cube.
        intensity : (N,) float32
            Their mean intensity.
        """
        self._background.wait()
        whole, rigid = GlobalMap(self._config.map_voxel), final.rigid
        for submap in self._submaps():
            moved = final.T_map_odom(np.array([submap.stamp_ns]))[0] if rigid is None else None
            whole.merge(submap.cells, moved)
        points, intensity = self._averaged(whole)
        if rigid is not None and not np.array_equal(rigid, np.eye(4)):
            points = transformed(points, rigid)
        return points, intensity

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

    def _averaged(self, whole: GlobalMap) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if self._config.surface_thickness == 0.0:
            return whole.points(), whole.intensity()
        return whole.surfaces(self._config.surface_thickness, threads=self._threads)

    def _add(self, result: ScanResult) -> None:
        try:
            if self._keyframe is None or self._is_keyframe(*self._keyframe, result):
                self._close_submap()
                self._keyframe = (result.end_ns, result.T_odom_imu)
        finally:
            self._open.insert(result.points_imu, result.intensity, result.T_odom_imu)

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

    def _submaps(self) -> Iterator[Submap]:
        """Yield those on disk, then what has come since."""
        # With a second thread the next one is read while this one is merged.
        on_disk = read_submaps(self.path)
        yield from on_disk if self._threads == 1 else prefetch(on_disk, _READ_AHEAD)
        if self._keyframe is not None:
            yield self._unfinished(self._keyframe)

    def _unfinished(self, keyframe: tuple[int, NDArray[np.float64]]) -> Submap:
        return Submap(stamp_ns=keyframe[0], T_odom_imu=keyframe[1], cells=self._open.cells())
