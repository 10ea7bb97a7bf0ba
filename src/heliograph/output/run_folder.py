"""The folder that a run leaves behind (DESIGN: the command line is a contract)."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import check_output_directory, remove_partials, write_text
from heliograph.config import OutputConfig
from heliograph.data import ImuBatch, Message, OnlineCalibration, ScanResult
from heliograph.errors import DataError, OutputError
from heliograph.io.files.clouds import write_cloud
from heliograph.maps import MapPoints
from heliograph.output.facts import final_facts
from heliograph.output.lock import FolderLock
from heliograph.output.map_file import FinishedMap, MapBounds, write_map
from heliograph.output.map_writer import MapWriter
from heliograph.output.raw_files import bring_back, drop_raw, keep_raw, remove_checkpoint
from heliograph.output.record import RunRecord
from heliograph.output.scan_log import ScanLog
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary
from heliograph.output.survey_files import remove_survey
from heliograph.output.trajectories import FILES, TrajectoryFiles
from heliograph.snapshots import PART, Snapshot, require

__all__ = ["RunFolder"]

_FLUSH_EVERY = 50  # scans; a crash costs at most these
_OWN_FORMATS = ("ply", "pcd")  # written without any other package
_MAPS = ("map.ply", "map.pcd", "map.laz")
SUBMAPS = "submaps.bin"
_Block: TypeAlias = tuple[MapBounds, MapPoints]
_GRAPH = ("loops.csv", "gnss.csv", "graph.g2o", "graph.npz")
_KEYFRAMES = "keyframes"
_EDITS = ("edits.toml", "loops_unedited.csv")  # of the run that was here before
_GROWING = (*FILES, SUBMAPS, "scans.csv")
_MADE_AT_THE_END = (*_MAPS, *_GRAPH, "map.png", "map.pgw", "report.html")
_OWN = (
    *FILES,
    *_MAPS,
    *_GRAPH,
    *_EDITS,
    SUBMAPS,
    "map.png",
    "map.pgw",
    "scans.csv",
    "report.html",
    "config.toml",
    "run.json",
)


_STATE = {
    "count": int,
    "calibration": (OnlineCalibration, None),
    "writer_seconds": {str: float},
    "trajectories": PART,
    "log": PART,
    "map": PART,
}


class RunFolder(Sink):
    """Writes trajectory, map, table, report and account of a run.

    Rows go to disk as they come, so that a crash leaves valid files of what was done; `close` adds the map,
    whatever the ``finishers`` draw, and last ``run.json``.

    Parameters
    ----------
    path : Path
        The folder; made if absent.
    name : str
        The recording's name.
    config : str
        The resolved configuration as TOML, written as ``config.toml``.
    output : OutputConfig
        The map's cubes and format, the frame whose poses are written, when a keyframe comes.
    T_imu_body : (4, 4) float64
        The frame whose poses are written, on the IMU.
    has_map : bool
        False where there is no LiDAR, so no map.
    threaded : bool
        Whether the map is added up in a thread of its own.
    facts : callable
        Returns what ``run.json`` says beside the results (recording, inferences, versions); asked before and after
        the run.
    finishers : sequence of callable
        Each takes the `RunRecord` and returns the paths of the files that it wrote.
    overwrite : bool
        Replace an earlier run.
    resume : bool
        Go on with a run that was cut off: its files stay, and `restore` opens them where its checkpoint knew them.

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
        output: OutputConfig,
        T_imu_body: NDArray[np.float64],
        has_map: bool = True,
        threaded: bool = False,
        facts: Callable[[], Mapping[str, Any]] = dict,
        finishers: Sequence[Callable[[RunRecord], list[Path]]] = (),
        overwrite: bool = False,
        resume: bool = False,
    ) -> None:
        self._created = not path.exists()
        self._lock = FolderLock(path) if path.is_dir() else None
        try:
            self.path = check_output_directory(path, overwrite or resume)
            self._lock = self._lock or FolderLock(path)
        except BaseException:
            self._unlock()
            raise
        self.name, self.config, self._output, self._finishers = name, config, output, tuple(finishers)
        self._facts = facts
        self.facts: dict[str, Any] = dict(facts())
        self.files: list[Path] = []
        self.writer_seconds: dict[str, float] = {}
        self.record: RunRecord | None = None
        self._map: MapWriter | None = None
        self._trajectories: TrajectoryFiles | None = None
        self._log = ScanLog(self.path / "scans.csv")
        self._count = 0
        self._calibration: OnlineCalibration | None = None
        self._has_map, self._T_imu_body, self._threaded = has_map, T_imu_body, threaded
        self._goes_on = resume
        if resume:
            return  # all stays as it is until it is known from where to go on
        with self._nothing_left_on_failure():
            self._say_running()
            if has_map and output.map_format not in _OWN_FORMATS:
                # What the format needs may not be installed; that must not come out after an hour's run.
                write_cloud(self._map_path, np.zeros((1, 3), dtype=np.float32))
                self._map_path.unlink()
            self._open_files()

    def _say_running(self) -> None:
        write_text(self.path / "config.toml", self.config)
        text = json.dumps({"status": "running", **self.facts}, indent=2, default=str) + "\n"
        write_text(self.path / "run.json", text)

    def _open_files(self, earlier: Snapshot | None = None) -> None:
        """Begin the files that grow with the run, or go on behind what an earlier one has written of them."""
        version = str(self.facts.get("versions", {}).get("heliograph", ""))
        stamp = "header stamp of a LiDAR message [s]" if self._has_map else "time of the pose [s]"
        self._trajectories = TrajectoryFiles(
            self.path,
            body=self._output.body,
            T_imu_body=self._T_imu_body,
            version=version,
            stamp=stamp,
            sizes=None if earlier is None else earlier["trajectories"].get("sizes"),
        )
        self._log = ScanLog(self.path / "scans.csv")
        if self._has_map:
            found = None if earlier is None else earlier["map"]
            self._map = MapWriter(self.path / SUBMAPS, self._output, threaded=self._threaded, earlier=found)

    def snapshot(self) -> Snapshot:
        """Return what the next results are added to; what is written by then is on the disk."""
        assert self._trajectories is not None
        return {
            "count": self._count,
            "calibration": self._calibration,
            "writer_seconds": self.writer_seconds,
            "trajectories": self._trajectories.snapshot(),
            "log": self._log.snapshot(),
            "map": None if self._map is None else self._map.snapshot(),
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Go on with the files of an earlier run where its checkpoint knew them.

        Raises
        ------
        DataError
            It is no state of such a folder.
        FormatError
            A file does not hold what was written.
        """
        require(self, snapshot, _STATE)
        if (snapshot["map"] is None) == self._has_map:
            raise DataError("the state of a run's folder is one with other sensors")
        bring_back(self.path, _GROWING)
        self._open_files(snapshot)
        assert self._trajectories is not None
        self._trajectories.restore(snapshot["trajectories"])
        self._log.restore(snapshot["log"])
        self._count, self._calibration = snapshot["count"], snapshot["calibration"]
        self.writer_seconds = snapshot["writer_seconds"]
        self._remove_partials()
        for name in _MADE_AT_THE_END:
            (self.path / name).unlink(missing_ok=True)
        self._say_running()

    def restart(self) -> None:
        """Begin the files anew; what they held is gone."""
        self._release()
        with self._nothing_left_on_failure():
            self._say_running()
            self._map, self._count, self._calibration = None, 0, None
            self._open_files()

    def observe(self, message: Message) -> None:
        """Note the IMU's stamps."""
        if isinstance(message, ImuBatch) and self._trajectories is not None:
            self._trajectories.observe(message)

    def add(self, result: ScanResult) -> None:
        """Write a scan's rows and add its points to the map."""
        assert self._trajectories is not None
        with self._timed("trajectory"):
            self._trajectories.add(result)
        with self._timed("scans.csv"):
            self._log.add(result)
        if self._map is not None and len(result.points_imu) and result.status != "lost":
            with self._timed("map"):
                self._map.add(result)
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
        assert self._trajectories is not None
        failures: list[Exception] = []
        began = time.perf_counter()
        with self._step("checkpoint", failures):
            keep_raw(self.path, _GROWING)
        blocks, written = None, FinishedMap()
        with self._step("map", failures):
            blocks = self._held_map(summary)
        table = self._log.table(summary.final, summary.level)
        self.files += [*self._trajectories.paths, self._log.path]
        self.files += [self.path / name for name in (summary.graph.files if summary.graph is not None else ())]
        with self._step("trajectory", failures):
            self._trajectories.close(summary.final, summary.T_map_odom)
        with self._step("scans.csv", failures):
            self._log.close(table)
        with self._step("map", failures):
            written = self._write_map(summary, blocks)
        self.facts = dict(self._facts())
        if self._calibration is not None:
            self.facts["online_calibration"] = self._calibration.summary()
        self.record = RunRecord(
            name=self.name, folder=self.path, summary=summary, scans=table, points_map=written.points,
            intensity=written.intensity, map_points=written.count,
            moving_points=0 if self._map is None else self._map.dropped, facts=self.facts, config=self.config,
        )  # fmt: skip
        for finisher in self._finishers:
            with self._step("report", failures):
                self.files += finisher(self.record)
        self.files += [self.path / "config.toml", self.path / "run.json"]
        with self._step("run.json", failures):
            closing = time.perf_counter() - began
            files = [path for path in dict.fromkeys(self.files) if path.exists()]
            self.facts = final_facts(self.facts, self.record, files, self.writer_seconds, closing, failures)
            self._write_account()
        if not (failures or summary.failure or summary.interrupted):
            remove_checkpoint(self.path)
        self._unlock()
        if failures:
            raise failures[0]

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the files of a run that never came to its `close`; without a scan, remove them."""
        if self.record is None and self._count == 0 and not self._goes_on:
            self._discard()
        else:
            self._release()
        self._unlock()

    @property
    def _map_path(self) -> Path:
        return self.path / f"map.{self._output.map_format}"

    def _held_map(self, summary: RunSummary) -> list[_Block] | None:
        """Return the whole map after a failure, and remove what it was made of at once: the disk may be full."""
        if self._map is None or not summary.failure:
            return None
        blocks = list(self._map.blocks(summary.final))
        self._map.release(keep=False)
        drop_raw(self.path, SUBMAPS)
        return blocks

    def _write_map(self, summary: RunSummary, blocks: list[_Block] | None) -> FinishedMap:
        """Write the map, then remove what it was made of; where there is no room, the other way round."""
        if self._map is None:
            return FinishedMap()
        written, keep = FinishedMap(), True
        try:
            try:
                written = write_map(self._map_path, self._map.blocks(summary.final) if blocks is None else blocks)
            except OutputError:
                blocks = list(self._map.blocks(summary.final)) if blocks is None else blocks
                self._map.release(keep=False)
                drop_raw(self.path, SUBMAPS)
                written = write_map(self._map_path, blocks)
            keep = self._output.keep_submaps or (not written.count and self._map.submaps > 0)
        finally:
            self.files += [self._map_path] if written.count else []
            if self._map.release(keep=keep):
                self.files.append(self._map.path)
        return written

    def _write_account(self) -> None:
        """Write ``run.json``; on a full disk over the first one, which must not say any more that it runs."""
        path = self.path / "run.json"
        try:
            write_text(path, json.dumps(self.facts, indent=2, allow_nan=False) + "\n")
        except OutputError:
            told = {key: self.facts[key] for key in ("status", "interrupted", "failure", "scans", "files")}
            told["status"] = "incomplete" if told["status"] == "ok" else told["status"]
            text = json.dumps(told, indent=2) + "\n"
            with path.open("r+b") as file:  # in place: what it takes is its own already
                file.write(text.encode().ljust(max(path.stat().st_size, len(text)), b"\n"))
            raise

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def _discard(self) -> None:
        """Leave nothing of a run that has no result."""
        self._release()
        self._unlock()
        self._remove()

    def _release(self) -> None:
        if self._trajectories is not None:
            self._trajectories.release()
        self._log.release()
        if self._map is not None:
            self._map.release(keep=True)

    def _clear(self) -> None:
        self._remove_partials()
        for name in _OWN:
            (self.path / name).unlink(missing_ok=True)
        remove_checkpoint(self.path)
        remove_survey(self.path)
        keyframes = self.path / _KEYFRAMES
        if (keyframes / "journal.jsonl").is_file():
            shutil.rmtree(keyframes, ignore_errors=True)

    def _remove_partials(self) -> None:
        for folder in (self.path, self.path / _KEYFRAMES):
            remove_partials(folder)

    def _remove(self) -> None:
        self._clear()
        if self._created and self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()

    @contextmanager
    def _nothing_left_on_failure(self) -> Iterator[None]:
        """Clear the folder of an earlier run's files, and again if the block fails."""
        self._clear()
        try:
            yield
        except BaseException:
            self._unlock()
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
