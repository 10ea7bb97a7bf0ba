"""One row a scan: kept small in memory for the report, written to ``scans.csv`` as it comes."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.data import OnlineCalibration, ScanResult
from heliograph.errors import DataError, FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.csvs import CsvWriter
from heliograph.lie import so3
from heliograph.output.final_poses import FinalPoses
from heliograph.output.level import Level
from heliograph.snapshots import Snapshot, array, require

__all__ = ["ScanLog", "ScanTable", "rewrite_scans"]

_XYZ = ("x", "y", "z")
_ASCENDING = ("min", "mid", "max")


def _triple(name: str, suffixes: Sequence[str] = _XYZ) -> tuple[str, ...]:
    return tuple(f"{name}_{suffix}" for suffix in suffixes)


INTEGERS = (
    "index",
    "stamp_ns",
    "header_stamp_ns",
    "end_ns",
    "points",
    "queries",
    "matches",
    "fallback_matches",
    "iterations",
)
FLOATS = (
    "rms",
    "nis",
    *_triple("eigenvalue_rotation", _ASCENDING),
    *_triple("eigenvalue_translation", _ASCENDING),
    *_triple("weak_direction"),
    "weak_share",
    "weak_sigma",
    *_triple("gyro_bias"),
    *_triple("accel_bias"),
    *_triple("velocity"),
    *_triple("sigma_rotation"),
    *_triple("sigma_position"),
    *_triple("sigma_gyro_bias"),
    *_triple("sigma_accel_bias"),
    *_triple("position"),
)
# Written after the others where mounting and clock are estimated along; they are not remembered for the report.
CALIBRATION = (
    *_triple("mounting_rotation"),
    *_triple("lever_arm"),
    "imu_offset",
    "imu_drift_ppm",
    *_triple("sigma_mounting_rotation"),
    *_triple("sigma_lever_arm"),
    "sigma_imu_offset",
    "sigma_imu_drift_ppm",
    "directions_kept",
)
_REMEMBERED = ("integers", "floats", "pose_covariances", "rotations", "calibrations")  # rows of arrays
_STATE = {
    **dict.fromkeys(_REMEMBERED[1:], np.ndarray), "integers": (array(np.int64, None, len(INTEGERS)), array(float, 0)),
    "statuses": np.ndarray, "timings": np.ndarray, "stages": [str], "first_stages": [str], "size": (int, None),
}  # fmt: skip
# Columns in the odom frame, which turn when gravity is re-estimated at the end or a back-end moves the scan.
ODOM_VECTORS = ("weak_direction", "velocity", "position")


class ScanTable:
    """The scans of a run as named columns.

    Parameters
    ----------
    integers : (N, 9) int64
        Columns `INTEGERS`.
    floats : (N, 34) float64
        Columns `FLOATS`, in map-frame axes where they are vectors.
    statuses : list of str
        Verdict a scan.
    stages : mapping
        Stage -> (N,) float64 milliseconds, zero where a scan did not pass it.
    """

    def __init__(
        self,
        integers: NDArray[np.int64],
        floats: NDArray[np.float64],
        statuses: list[str],
        stages: dict[str, NDArray[np.float64]],
    ) -> None:
        self._integers, self.floats = integers, floats
        self.statuses, self.stages = statuses, stages

    def __len__(self) -> int:
        return len(self._integers)

    def __getitem__(self, name: str) -> NDArray[np.float64] | NDArray[np.int64]:
        if name in INTEGERS:
            return self._integers[:, INTEGERS.index(name)]
        return self.floats[:, FLOATS.index(name)]

    def triple(self, name: str) -> NDArray[np.float64]:
        """Return the (N, 3) columns of a vector such as ``"gyro_bias"`` or ``"eigenvalue_rotation"``."""
        first = next(i for i, column in enumerate(FLOATS) if column.rpartition("_")[0] == name)
        return self.floats[:, first : first + 3]

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Time of each scan's end since the first one's [s]."""
        ends = self._integers[:, INTEGERS.index("end_ns")]
        return (ends - ends[0]) * 1e-9 if len(ends) else np.zeros(0)


class ScanLog:
    """Writes ``scans.csv`` row by row and remembers the rows (about 0.5 KB a scan).

    Parameters
    ----------
    path : Path
        The CSV file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._integers: list[tuple[int, ...]] = []
        self._floats: list[NDArray[np.float64]] = []
        self._statuses: list[str] = []
        self._timings: list[dict[str, float]] = []
        self._pose_covariances: list[NDArray[np.float64]] = []
        self._rotations: list[NDArray[np.float64]] = []
        self._calibrations: list[NDArray[np.float64]] = []
        self._writer: CsvWriter | None = None
        self._stages: tuple[str, ...] = ()

    def add(self, result: ScanResult) -> None:
        """Append one scan's row."""
        integers = (
            *(result.index, result.stamp_ns, result.header_stamp_ns, result.end_ns, len(result.points_imu)),
            *(result.queries, result.matches, result.fallback_matches, result.iterations),
        )
        floats = np.concatenate([
            (result.rms, result.nis),
            result.eigenvalues_rotation, result.eigenvalues_translation, result.weak_direction,
            (result.weak_share, result.weak_sigma),
            result.gyro_bias, result.accel_bias, result.v_odom, sigmas(result), result.T_odom_imu[:3, 3],
        ])  # fmt: skip
        self._integers.append(integers)
        self._floats.append(floats)
        self._statuses.append(result.status)
        if result.calibration is not None:
            self._calibrations.append(_calibration(result.calibration))
        self._timings.append(dict(result.timings))
        self._pose_covariances.append(np.stack([result.pose_covariance[:3, :3], result.pose_covariance[3:, 3:]]))
        self._rotations.append(result.T_odom_imu[:3, :3].copy())
        if self._writer is None:
            self._stages = tuple(result.timings)
            self._writer = CsvWriter(self.path, self._columns())
        self._writer.append(self._row(integers, floats, len(self._integers) - 1))

    def snapshot(self) -> Snapshot:
        """Return all rows, and the size of the file, which is on the disk."""
        columns = {name: np.array(getattr(self, f"_{name}")) for name in _REMEMBERED}
        stages = tuple(dict.fromkeys(stage for timings in self._timings for stage in timings))
        timings = np.array([[timings.get(stage, np.nan) for stage in stages] for timings in self._timings])
        first = () if self._writer is None else self._stages
        return {
            **columns, "statuses": np.array(self._statuses, dtype=np.str_), "timings": timings, "stages": stages,
            "first_stages": first, "size": None if self._writer is None else self._writer.size,
        }  # fmt: skip

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the rows of an earlier log, and go on behind those of its file.

        Raises
        ------
        DataError
            It is none of a log.
        FormatError
            The file does not hold them.
        """
        require(self, snapshot, _STATE)
        integers, stages = snapshot["integers"], snapshot["stages"]
        if any(len(snapshot[name]) not in (0, len(integers)) for name in (*_REMEMBERED, "statuses", "timings")):
            raise DataError("the state of a log has columns of several lengths")
        self._integers = [tuple(row) for row in integers.tolist()] if len(integers) else []
        for name in _REMEMBERED[1:]:
            setattr(self, f"_{name}", list(snapshot[name]))
        self._statuses = snapshot["statuses"].tolist()
        self._timings = [
            {stage: ms for stage, ms in zip(stages, row, strict=True) if ms == ms}
            for row in snapshot["timings"].tolist()
        ]
        if snapshot["size"] is not None:
            self._stages = snapshot["first_stages"]
            self._writer = CsvWriter(self.path, self._columns(), at=snapshot["size"])

    def flush(self) -> None:
        """Hand the rows so far to the operating system."""
        if self._writer is not None:
            self._writer.flush()

    def release(self) -> None:
        """Flush and close the file as it is."""
        if self._writer is not None:
            self._writer.close()

    def table(self, final: FinalPoses, level: Level | None = None) -> ScanTable:
        """Return the rows so far in the map frame, where ``final`` puts the scans; ``level`` adds to their sigmas."""
        level = level if level is not None else Level()
        floats = np.array(self._floats).reshape(-1, len(FLOATS))
        integers = np.array(self._integers, dtype=np.int64).reshape(-1, len(INTEGERS))
        T_map_odom = final.rigid
        if T_map_odom is None:
            T_map_odom = final.T_map_odom(integers[:, INTEGERS.index("end_ns")])
        if level.known or not np.array_equal(T_map_odom, np.eye(4)):
            floats = self._moved(floats, T_map_odom, level)
        stages = tuple(dict.fromkeys(stage for timings in self._timings for stage in timings))
        milliseconds = {stage: np.array([timings.get(stage, 0.0) for timings in self._timings]) for stage in stages}
        return ScanTable(integers, floats, list(self._statuses), milliseconds)

    def close(self, table: ScanTable) -> None:
        """Finish the file.

        It is written anew where the rows moved since they were written, or where a later scan named a stage that the
        first one did not have.
        """
        self.release()
        written = np.array(self._floats).reshape(-1, len(FLOATS))
        if self._writer is not None and not (
            tuple(table.stages) == self._stages and np.array_equal(table.floats, written, equal_nan=True)
        ):
            self._stages = tuple(table.stages)
            self._rewrite(table.floats)

    def _columns(self) -> tuple[str, ...]:
        more = CALIBRATION if self._calibrations else ()
        return (*INTEGERS, "verdict", *FLOATS, "ms_total", *(f"ms_{stage}" for stage in self._stages), *more)

    def _row(self, integers: tuple[int, ...], floats: NDArray[np.float64], number: int) -> list[int | float | str]:
        timings = self._timings[number]
        stages = [round(timings.get(stage, 0.0), 4) for stage in self._stages]
        more = _shortened(self._calibrations[number]) if self._calibrations else []
        total = round(sum(timings.values()), 4)
        return [*integers, self._statuses[number], *_shortened(floats), total, *stages, *more]

    def _moved(self, floats: NDArray[np.float64], T_map_odom: NDArray[np.float64], level: Level) -> NDArray[np.float64]:
        """Return the rows with their vectors moved by one (4, 4) for all, or by one a row (N, 4, 4), and their sigmas.

        What is not known of the level is an error of the map's pose against the earth; rows in the odom frame, whose
        first pose defines it, have none of it.
        """
        R_map_odom = T_map_odom[..., :3, :3]
        R_odom_map = R_map_odom.swapaxes(-1, -2)
        floats = floats.copy()
        for name in ODOM_VECTORS:
            first = FLOATS.index(f"{name}_x")
            vectors = floats[:, first : first + 3]
            turned = vectors @ R_odom_map if R_odom_map.ndim == 2 else (vectors[:, None] @ R_odom_map)[:, 0]
            floats[:, first : first + 3] = turned + T_map_odom[..., :3, 3] if name == "position" else turned
        of_rotation, of_position = np.array(self._pose_covariances).reshape(-1, 2, 3, 3).swapaxes(0, 1)
        p_odom = np.array(self._floats).reshape(-1, len(FLOATS))[:, FLOATS.index("position_x") :][:, :3]
        of_rotation = of_rotation + level.of_rotations(np.array(self._rotations).reshape(-1, 3, 3))
        of_position = R_map_odom @ (of_position + level.of_positions(p_odom)) @ R_odom_map
        for name, covariances in (("sigma_rotation_x", of_rotation), ("sigma_position_x", of_position)):
            first = FLOATS.index(name)
            floats[:, first : first + 3] = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
        return floats

    def _rewrite(self, floats: NDArray[np.float64]) -> None:
        with atomic_path(self.path) as temporary, CsvWriter(temporary, self._columns()) as writer:
            for number, (integers, row) in enumerate(zip(self._integers, floats, strict=True)):
                writer.append(self._row(integers, row, number))


def rewrite_scans(path: Path, final: FinalPoses, to: Path) -> NDArray[np.float64]:
    """Write a run's ``scans.csv`` with its vectors where the scans have been after all; return the positions (N, 3).

    Parameters
    ----------
    path : Path
        The file as the run wrote it.
    final : FinalPoses
        Moves the file's frame.
    to : Path
        Where to write.

    Raises
    ------
    FormatError
        It is no ``scans.csv``.
    """
    try:
        with plain_file(path, TABLE).open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            columns, rows = tuple(reader.fieldnames or ()), list(reader)
        if any(None in row or None in row.values() for row in rows):
            raise ValueError("a row has another number of cells than the header")
        T = final.T_map_odom(np.array([int(row["end_ns"]) for row in rows], dtype=np.int64))
        moved = np.zeros((0, 3))
        for name in ODOM_VECTORS:
            cells = [f"{name}_{axis}" for axis in _XYZ]
            vectors = np.array([[float(row[cell] or "nan") for cell in cells] for row in rows]).reshape(-1, 3)
            moved = np.einsum("nij,nj->ni", T[:, :3, :3], vectors) + (T[:, :3, 3] if name == "position" else 0.0)
            for row, vector in zip(rows, moved, strict=True):
                row |= {cell: repr(v) if v == v else "" for cell, v in zip(cells, _shortened(vector), strict=True)}
    except (LookupError, ValueError, TypeError, ArithmeticError, csv.Error) as error:
        raise FormatError(path, f"is no table of scans ({error}); run the recording again") from error
    with CsvWriter(to, columns) as writer:
        for row in rows:
            writer.append(row)
    return moved


def sigmas(result: ScanResult) -> NDArray[np.float64]:
    """Return (12,) sigmas of rotation (body axes), position (odom axes), gyro bias and accelerometer bias."""
    variances = np.concatenate([np.diagonal(result.pose_covariance), np.diagonal(result.covariance)[9:15]])
    deviations: NDArray[np.float64] = np.sqrt(np.maximum(variances, 0.0))
    return deviations


def _calibration(found: OnlineCalibration) -> NDArray[np.float64]:
    turn = so3.log(found.T_imu_lidar[:3, :3])
    clock, sigma = (found.imu_offset, 1e6 * found.imu_drift), (*found.sigma[:7], 1e6 * found.sigma[7])
    return np.concatenate([turn, found.T_imu_lidar[:3, 3], clock, sigma, [found.kept.sum()]])


def _shortened(floats: NDArray[np.float64]) -> list[float]:
    """Round to seven significant digits: what the numbers are good for, and a third of the file."""
    return [float(f"{value:.7g}") for value in floats.tolist()]
