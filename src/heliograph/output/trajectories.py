"""The three trajectory files of a run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.data import ImuBatch, ScanResult, Trajectory
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.tum import TumWriter, parse_seconds
from heliograph.lie import so3
from heliograph.output.final_poses import FinalPoses
from heliograph.snapshots import Snapshot, array, require

__all__ = ["FILES", "TrajectoryFiles", "rewrite"]

_TRAJECTORY, _ODOMETRY, _IMU_RATE = FILES = ("trajectory.tum", "odometry.tum", "trajectory_imu_rate.tum")
TRAJECTORY_STATE = {"sizes": {str: int}, "pending": [array(np.int64, None)], "last_scan_ns": int}
_BLOCK = 4096  # rows rewritten at once


class TrajectoryFiles:
    """Streams poses of one body frame to disk; nothing of them stays in memory.

    Parameters
    ----------
    folder : Path
        Where to write.
    body : str
        Name of the frame whose poses are written.
    T_imu_body : (4, 4) float64
        That frame on the IMU.
    version : str
        For the first line of each file.
    stamp : str
        Meaning of the stamps of ``trajectory.tum`` and ``odometry.tum``, likewise.
    sizes : mapping of str to int, optional
        Bytes of each file of a run that is taken up again: it goes on behind them.
    """

    def __init__(
        self,
        folder: Path,
        *,
        body: str,
        T_imu_body: NDArray[np.float64],
        version: str,
        stamp: str,
        sizes: Mapping[str, int] | None = None,
    ) -> None:
        self.folder, self.body, self.T_imu_body, self.version = folder, body, T_imu_body, version
        sizes = sizes or {}
        self._scan_rate: dict[str, TumWriter] = {}
        self._imu_rate: TumWriter | None = None
        try:
            for name, frame in ((_TRAJECTORY, "map"), (_ODOMETRY, "odom")):
                self._scan_rate[name] = TumWriter(folder / name, self.header(frame, stamp), at=sizes.get(name))
            if _IMU_RATE in sizes:
                self._imu_rate = self._opened_imu_rate(sizes[_IMU_RATE])
        except BaseException:
            self.release()
            raise
        self._pending: list[NDArray[np.int64]] = []
        self._last_scan_ns = np.iinfo(np.int64).min

    def header(self, frame: str, stamp: str) -> str:
        """Return a file's first line."""
        transform = f"T_{frame}_{self.body} (p_{frame} = T p_{self.body})"
        return f"heliograph {self.version}: {transform}, stamp = {stamp}, x y z [m] qx qy qz qw"

    def observe(self, batch: ImuBatch) -> None:
        """Remember the IMU's stamps: they tell which poses of a path belong to a sample."""
        self._pending.append(batch.stamps_ns)

    def add(self, result: ScanResult) -> None:
        """Append a scan's row, and one row for each IMU sample since the scan before."""
        if result.header_stamp_ns > self._last_scan_ns:  # a duplicate or rewound message adds no row
            self._last_scan_ns = result.header_stamp_ns
            for writer in self._scan_rate.values():
                writer.append(result.header_stamp_ns, result.T_odom_imu_header @ self.T_imu_body)
        if self._pending:
            self._add_imu_rows(result.path)

    def _add_imu_rows(self, path: Trajectory) -> None:
        if not len(path):
            return
        samples = np.concatenate(self._pending)
        new = np.isin(path.stamps_ns, samples)
        new[1:] &= np.diff(path.stamps_ns) > 0
        self._pending = [samples[samples > path.stamps_ns[-1]]]  # so that a sample at a scan's end comes once
        if not new.any():
            return
        if self._imu_rate is None:
            self._imu_rate = self._opened_imu_rate()
        self._imu_rate.extend(path.stamps_ns[new], path.T_frame_body[new] @ self.T_imu_body)

    def _opened_imu_rate(self, at: int | None = None) -> TumWriter:
        return TumWriter(self.folder / _IMU_RATE, self.header("map", "time of an IMU sample [s]"), at=at)

    def snapshot(self) -> Snapshot:
        """Return what the next rows depend on, and the sizes of the files, which are on the disk."""
        return {
            "sizes": {writer.path.name: writer.size for writer in self.writers()},
            "pending": self._pending,
            "last_scan_ns": int(self._last_scan_ns),
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of earlier files, opened at the ``sizes`` of that."""
        require(self, snapshot, TRAJECTORY_STATE)
        self._pending, self._last_scan_ns = snapshot["pending"], snapshot["last_scan_ns"]

    def writers(self) -> Iterator[TumWriter]:
        """Yield the open files."""
        yield from self._scan_rate.values()
        if self._imu_rate is not None:
            yield self._imu_rate

    def flush(self) -> None:
        """Hand the rows so far to the operating system."""
        for writer in self.writers():
            writer.flush()

    def release(self) -> None:
        """Flush and close the files as they are."""
        for writer in self.writers():
            writer.close()

    @property
    def paths(self) -> list[Path]:
        """The files."""
        return [writer.path for writer in self.writers()]

    def close(self, final: FinalPoses, T_leveled_odom: NDArray[np.float64]) -> None:
        """Finish the files: those that were not written in their final frame are written anew.

        Parameters
        ----------
        final : FinalPoses
            Where the run has been after all, for the files of the map frame.
        T_leveled_odom : (4, 4) float64
            What puts z of odom up, for the file of the odom frame.
        """
        self.release()
        for path in self.paths:
            rewrite(path, FinalPoses.moved_by(T_leveled_odom) if path.name == _ODOMETRY else final)


def rewrite(path: Path, final: FinalPoses, to: Path | None = None) -> None:
    """Write a TUM file anew with each pose where it has been after all, block by block; all of it or nothing.

    Parameters
    ----------
    path : Path
        The file.
    final : FinalPoses
    to : Path, optional
        Where to write; by default the file itself, which is left alone where nothing moved.

    Raises
    ------
    FormatError
        It is no TUM file any more.
    """
    rigid = final.rigid
    if to is None and rigid is not None and np.array_equal(rigid, np.eye(4)):
        return
    with plain_file(path, TABLE).open(encoding="utf-8", errors="replace") as file:
        header = file.readline().lstrip("# ").strip()
        with atomic_path(to or path) as temporary, TumWriter(temporary, header) as writer:
            while lines := list(itertools.islice(file, _BLOCK)):
                stamps_ns, values = _rows(path, lines)
                T_odom_body = np.tile(np.eye(4), (len(lines), 1, 1))
                T_odom_body[:, :3, 3] = values[:, :3]
                T_odom_body[:, :3, :3] = so3.from_quaternion(values[:, 3:])
                T_map_odom = final.T_map_odom(stamps_ns) if rigid is None else rigid
                writer.extend(stamps_ns, T_map_odom @ T_odom_body)


def _rows(path: Path, lines: Sequence[str]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return stamps (N,) and numbers (N, 7) of a file that was written whole, but by now may be anything."""
    try:
        rows = [line.split() for line in lines]
        stamps_ns = np.array([parse_seconds(row[0]) for row in rows], dtype=np.int64)
        values = np.array([[float(word) for word in row[1:]] for row in rows]).reshape(len(rows), -1)
        if values.shape[1] != 7 or not np.isfinite(values).all():
            raise ValueError("rows of a TUM file are a stamp and seven numbers")
    except (LookupError, ValueError, ArithmeticError) as error:
        raise FormatError(path, f"is no trajectory ({error}); run the recording again") from error
    return stamps_ns, values
