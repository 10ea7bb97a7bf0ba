"""The folder that a run leaves behind (DESIGN: the command line is a contract)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import check_output_directory, write_text
from heliograph.data import GnssFix, ImuBatch, OnlineCalibration, Scan, ScanResult
from heliograph.errors import OutputError
from heliograph.io.files.clouds import write_cloud
from heliograph.output.facts import final_facts
from heliograph.output.record import RunRecord
from heliograph.output.scan_log import ScanLog
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary
from heliograph.output.trajectories import FILES, TrajectoryFiles

__all__ = ["MapAccumulator", "RunFolder"]

_FLUSH_EVERY = 50  # scans; a crash costs at most these
_OWN_FORMATS = ("ply", "pcd")  # written without any other package
_MAPS = ("map.ply", "map.pcd", "map.laz")
_OWN = (*FILES, *_MAPS, "map.png", "scans.csv", "report.html", "config.toml", "run.json")


class MapAccumulator(Protocol):
    """What the folder needs of the output map; `heliograph.maps.GlobalMap` is one."""

    def insert(
        self, points_imu: NDArray[np.float32], intensity: NDArray[np.float32] | None, T_map_imu: NDArray[np.float64]
    ) -> None:
        """Add a scan."""
        ...

    def points(self) -> NDArray[np.float32]:
        """Return (N, 3) averaged points [m]."""
        ...

    def intensity(self) -> NDArray[np.float32] | None:
        """Return their (N,) mean intensity."""
        ...


class RunFolder(Sink):
    """Writes trajectory, map, table, report and account of a run.

    Rows go to disk as they come, so that a crash leaves valid files of what was done; `close` adds the map,
    whatever the ``finishers`` draw, and last ``run.json``.

    Parameters
    ----------
    path : Path
        The folder; made if absent.
    name : str
        Of the recording.
    config : str
        The resolved configuration as TOML, written as ``config.toml``.
    body : str
        Name of the frame whose poses are written.
    T_imu_body : (4, 4) float64
        That frame on the IMU.
    global_map : MapAccumulator or None
        Collects the points; None where there is no LiDAR, so no map.
    map_format : str
        ``"ply"``, ``"pcd"`` or ``"laz"``.
    facts : callable
        Returns what ``run.json`` says beside the results (recording, inferences, versions); asked before and after
        the run.
    finishers : sequence of callable
        Each takes the `RunRecord` and returns the paths of the files that it wrote.
    overwrite : bool
        Replace an earlier run.

    Raises
    ------
    OutputError
        The folder is not empty, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        name: str,
        config: str,
        body: str,
        T_imu_body: NDArray[np.float64],
        global_map: MapAccumulator | None,
        map_format: str = "ply",
        facts: Callable[[], Mapping[str, Any]] = dict,
        finishers: Sequence[Callable[[RunRecord], list[Path]]] = (),
        overwrite: bool = False,
    ) -> None:
        self._created = not path.exists()
        self.path = check_output_directory(path, overwrite)
        self.name, self.config, self.map_format, self._finishers = name, config, map_format, tuple(finishers)
        self._facts = facts
        self.facts: dict[str, Any] = dict(facts())
        self.files: list[Path] = []
        self.writer_seconds: dict[str, float] = {}
        self.record: RunRecord | None = None
        self._map = global_map
        self._count = 0
        self._calibration: OnlineCalibration | None = None
        with self._nothing_left_on_failure():
            write_text(path / "config.toml", config)
            write_text(path / "run.json", json.dumps({"status": "running", **self.facts}, indent=2, default=str) + "\n")
            if global_map is not None and map_format not in _OWN_FORMATS:
                # What the format needs may not be installed; that must not come out after an hour's run.
                write_cloud(path / f"map.{map_format}", np.zeros((1, 3), dtype=np.float32))
                (path / f"map.{map_format}").unlink()
            version = str(self.facts.get("versions", {}).get("heliograph", ""))
            stamp = "time of the pose [s]" if global_map is None else "header stamp of a LiDAR message [s]"
            self._trajectories = TrajectoryFiles(path, body=body, T_imu_body=T_imu_body, version=version, stamp=stamp)
            self._log = ScanLog(path / "scans.csv")

    def observe(self, message: Scan | ImuBatch | GnssFix) -> None:
        """Note the IMU's stamps."""
        if isinstance(message, ImuBatch):
            self._trajectories.observe(message)

    def add(self, result: ScanResult) -> None:
        """Write a scan's rows and add its points to the map."""
        with self._timed("trajectory"):
            self._trajectories.add(result)
        with self._timed("scans.csv"):
            self._log.add(result)
        if self._map is not None and len(result.points_imu) and result.status != "lost":
            with self._timed("map"):
                self._map.insert(result.points_imu, result.intensity, result.T_odom_imu)
        self._calibration = result.calibration
        self._count += 1
        if self._count % _FLUSH_EVERY == 0:
            with self._timed("trajectory"):
                self._trajectories.flush()
                self._log.flush()

    def close(self, summary: RunSummary) -> None:
        """Complete the files. Every step is tried, whatever became of those before; the first failure is raised."""
        if summary.scans == 0:
            self._discard()
            return
        failures: list[Exception] = []
        began = time.perf_counter()
        with self._step("trajectory", failures):
            self.files += self._trajectories.close(summary.T_map_odom)
        with self._step("scans.csv", failures):
            table = self._log.close(summary.T_map_odom[:3, :3])
            self.files.append(self._log.path)
        points, intensity = self._map_cloud(summary.T_map_odom)
        with self._step("map", failures):
            if len(points):
                path = self.path / f"map.{self.map_format}"
                write_cloud(path, points, intensity)
                self.files.append(path)
        self.facts = dict(self._facts())
        if self._calibration is not None:
            self.facts["online_calibration"] = self._calibration.summary()
        self.record = RunRecord(
            name=self.name, folder=self.path, summary=summary, scans=table, points_map=points, intensity=intensity,
            facts=self.facts, config=self.config,
        )  # fmt: skip
        for finisher in self._finishers:
            with self._step("report", failures):
                self.files += finisher(self.record)
        self.files += [self.path / "config.toml", self.path / "run.json"]
        with self._step("run.json", failures):
            closing = time.perf_counter() - began
            self.facts = final_facts(self.facts, self.record, self.files, self.writer_seconds, closing, failures)
            write_text(self.path / "run.json", json.dumps(self.facts, indent=2, allow_nan=False) + "\n")
        if failures:
            raise failures[0]

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the files of a run that never came to its `close`; without a scan, remove them."""
        if self.record is None and self._count == 0:
            self._discard()
        self._trajectories.release()
        self._log.release()

    def _map_cloud(self, T_map_odom: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        if self._map is None:
            return np.zeros((0, 3), dtype=np.float32), None
        with self._timed("map"):
            points = self._map.points()
            if not np.array_equal(T_map_odom, np.eye(4)):
                points = _moved(points, T_map_odom)
            return points, self._map.intensity()

    def _discard(self) -> None:
        """Leave nothing of a run that has no result."""
        self._trajectories.release()
        self._log.release()
        self._remove()

    def _remove(self) -> None:
        for name in _OWN:
            (self.path / name).unlink(missing_ok=True)
        if self._created and self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()

    @contextmanager
    def _nothing_left_on_failure(self) -> Iterator[None]:
        """Clear the folder of an earlier run's files, and again if the block fails."""
        for name in _OWN:
            (self.path / name).unlink(missing_ok=True)
        try:
            yield
        except BaseException:
            self._remove()
            raise

    @contextmanager
    def _timed(self, writer: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.writer_seconds[writer] = self.writer_seconds.get(writer, 0.0) + time.perf_counter() - start

    @contextmanager
    def _step(self, writer: str, failures: list[Exception]) -> Iterator[None]:
        try:
            with self._timed(writer):
                yield
        except OSError as error:
            failures.append(OutputError(f"cannot write into {self.path}: {error.strerror or error}"))
        except Exception as error:
            failures.append(error)


def _moved(points: NDArray[np.float32], T: NDArray[np.float64]) -> NDArray[np.float32]:
    """Transform points (N, 3), block by block: all at once, BLAS would start threads that then spin beside us."""
    moved = np.empty_like(points)
    for first in range(0, len(points), 8192):
        block = points[first : first + 8192].astype(np.float64)
        moved[first : first + 8192] = block @ T[:3, :3].T + T[:3, 3]
    return moved
