"""Inertial samples from a text table whose columns are found by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.stamps import UNITS, is_number, parse_stamps

__all__ = ["ImuTable", "read_imu_table"]

_GYRO = r"(?:g|gyro|gyroscope|gyr|w|omega|angular_?vel(?:ocity)?|ang_?vel|rot(?:ation)?_?rate|av|w_rs_s)"
_ACCEL = r"(?:a|acc|accel|accelerometer|acceleration|linear_?acc(?:eleration)?|lin_?acc|la|f|a_rs_s)"
_TIME = r"(?:time|stamp|timestamp|t|sec|secs|seconds|time_?stamp)"
_SPLIT = re.compile(r"[,;\s]+")
_GRAVITY = 9.80665


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuTable:
    """Samples in the file's own units.

    Parameters
    ----------
    stamps_ns : (N,) int64
        [ns].
    gyro, accel : (N, 3) float64
        Angular rate and specific force, units as in the file.
    evidence : str
        In words: which columns were taken for what, and why.
    bad_rows : int
        Rows that were left out because they are incomplete or not numbers.
    """

    stamps_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    evidence: str
    bad_rows: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Columns:
    time: int
    gyro: tuple[int, int, int]
    accel: tuple[int, int, int]
    unit: str | None
    evidence: str


def read_imu_table(path: Path) -> ImuTable:
    """Read a CSV or blank-separated table of inertial samples.

    A header names the columns (``time``, ``gyro_x``, ``angular_velocity.x``, ``ax``, ``accelY`` ..., a unit in brackets
    after the time is heeded). Without a header the table must have seven columns, time first; the three whose median
    length is nearer to 1 g are then the specific force.

    Raises
    ------
    FormatError
        Columns are missing or not clear, or no row can be read.
    """
    try:
        lines = plain_file(path, TABLE).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror}") from error
    rows = [(_split(line), line) for line in lines if line.strip()]
    header, first = _header(rows)
    words = [row for row, _ in rows[first:] if not row[0].startswith("#")]
    columns = _columns_of_header(path, header) if header else _columns_by_physics(path, words)
    kept, table = _complete_rows(words, columns)
    if not kept:
        raise FormatError(path, "holds no complete row of numbers")
    try:
        stamps_ns, unit = parse_stamps(kept, columns.unit)
    except ValueError as error:
        raise FormatError(path, str(error)) from error
    return ImuTable(
        stamps_ns=stamps_ns,
        gyro=table[:, :3],
        accel=table[:, 3:],
        evidence=f"{columns.evidence}; stamps in {unit}",
        bad_rows=len(words) - len(kept),
    )


def _complete_rows(words: Sequence[Sequence[str]], columns: _Columns) -> tuple[list[str], NDArray[np.float64]]:
    """Return the stamps and the ``(N, 6)`` values of the rows that are complete and finite."""
    stamps, values = [], []
    for row in words:
        try:
            stamp, *numbers = (float(row[index]) for index in (columns.time, *columns.gyro, *columns.accel))
        except (ValueError, IndexError):
            continue
        if np.isfinite([stamp, *numbers]).all():
            stamps.append(row[columns.time])
            values.append(numbers)
    return stamps, np.array(values, dtype=np.float64)


def _split(line: str) -> list[str]:
    """Split at commas, semicolons or blanks; a comma-separated line keeps the blanks inside its cells."""
    for separator in (",", ";", "\t"):
        if separator in line:
            return [cell.strip() for cell in line.split(separator)]
    return _SPLIT.split(line.strip())


def _header(rows: Sequence[tuple[list[str], str]]) -> tuple[list[str], int]:
    """Return the names of the columns (empty without a header) and the index of the first row of data."""
    header: list[str] = []
    for index, (row, line) in enumerate(rows):
        if is_number(row[0]):
            return header, index
        header = _split(line.lstrip("# \t"))
    return header, len(rows)


def _columns_of_header(path: Path, header: Sequence[str]) -> _Columns:
    names = [re.sub(r"[\[(].*?[\])]", "", name).strip().strip('"').lower() for name in header]
    time = _column(names, rf"(?:.*[._/ ])?{_TIME}(?:_?(?:ns|us|ms|s))?")
    gyro, accel = _axis_columns(names, _GYRO), _axis_columns(names, _ACCEL)
    missing = [kind for kind, found in (("gyro", gyro), ("accel", accel), ("time", time)) if found is None]
    if time is None or gyro is None or accel is None:
        raise FormatError(
            path,
            f"has no columns for {', '.join(missing)}; name them time, gyro_x, gyro_y, gyro_z, accel_x, accel_y, "
            f"accel_z (it has {', '.join(header)})",
        )
    unit = re.search(r"(?:[\[(]\s*|_)(ns|us|ms|s)\b", header[time].lower())
    used = [header[i] for i in (time, *gyro, *accel)]
    return _Columns(
        time=time,
        gyro=gyro,
        accel=accel,
        unit=unit[1] if unit and unit[1] in UNITS else None,
        evidence=f"columns {', '.join(used)} by their names",
    )


def _column(names: Sequence[str], pattern: str) -> int | None:
    expression = re.compile(pattern)
    return next((index for index, name in enumerate(names) if expression.fullmatch(name)), None)


def _axis_columns(names: Sequence[str], sensor: str) -> tuple[int, int, int] | None:
    """Return the columns x, y, z of a sensor: ``gyro_x``, ``gyrox``, ``angular_velocity.x``, ``x_gyro``."""
    x, y, z = (_column(names, rf"(?:.*[./])?(?:{sensor}[._ ]?{axis}|{axis}[._ ]{sensor})") for axis in "xyz")
    return None if x is None or y is None or z is None else (x, y, z)


def _columns_by_physics(path: Path, words: Sequence[Sequence[str]]) -> _Columns:
    try:
        table = np.array([row for row in words if len(row) == 7], dtype=np.float64).reshape(-1, 7)
    except ValueError:
        table = np.empty((0, 7))
    if len(table) < max(1, len(words) // 2):
        raise FormatError(path, "has no header and not seven columns; add a line: time,gx,gy,gz,ax,ay,az")
    lengths = [float(np.median(np.linalg.norm(table[:, i : i + 3], axis=1))) for i in (1, 4)]
    # In m/s^2 or in g: compare ratios, on both scales.
    off = [min(abs(np.log(max(length, 1e-12) / g)) for g in (1.0, _GRAVITY)) for length in lengths]
    accel, gyro = ((1, 2, 3), (4, 5, 6)) if off[0] < off[1] else ((4, 5, 6), (1, 2, 3))
    length = lengths[0 if off[0] < off[1] else 1]
    return _Columns(
        time=0,
        gyro=gyro,
        accel=accel,
        unit=None,
        evidence=f"no header; columns {accel[0] + 1}-{accel[2] + 1} are the specific force: median length {length:.3g}",
    )
