"""Trajectory files: TUM (``stamp x y z qx qy qz qw``) and KITTI (12 numbers a row)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.atomic import atomic_path
from heliograph.data import Trajectory
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.rows import RowFile
from heliograph.lie import so3

__all__ = ["TumWriter", "parse_seconds", "read_kitti", "read_tum", "whole_ns", "write_tum"]

_NS = 1_000_000_000
_MIN_NS, _MAX_NS = -(1 << 63), (1 << 63) - 1
_MAX_STAMP = 60  # characters, or digits
_PLAIN_SECONDS = re.compile(r"([+-]?)(\d+)\.(\d{1,9})")
_ROW = "%s%d.%09d %.9f %.9f %.9f %.12f %.12f %.12f %.12f\n"
_MAX_ROTATION_DEFECT = 1e-3
_BATCH, _BATCH_ROWS = 100, 4096  # calls whose rows are formatted together, and rows: text takes ten times their memory


def _format_rows(stamps_ns: NDArray[np.int64], T_frame_body: NDArray[np.float64]) -> str:
    """Format poses as TUM rows; one ``%`` for all rows is what makes it fast."""
    magnitude = np.abs(stamps_ns)
    columns = (
        np.where(stamps_ns < 0, "-", "").tolist(),
        (magnitude // _NS).tolist(),
        (magnitude % _NS).tolist(),
        *T_frame_body[:, :3, 3].T.tolist(),
        *so3.to_quaternion(T_frame_body[:, :3, :3]).T.tolist(),
    )
    flat: list[object] = [None] * (len(columns) * len(stamps_ns))
    for index, column in enumerate(columns):
        flat[index :: len(columns)] = column
    return (_ROW * len(stamps_ns)) % tuple(flat)


class TumWriter:
    """TUM trajectory file that grows by rows; interrupted at any time, it holds only complete rows.

    Parameters
    ----------
    path : Path or str
        File to create; an existing one is replaced.
    header : str
        First line, written after ``# ``: frame, body, meaning of the stamps, version.
    at : int, optional
        Bytes of a file that is there: rows go on behind them [bytes].

    Raises
    ------
    OutputError
        The file cannot be created or written.
    """

    def __init__(self, path: Path | str, header: str, *, at: int | None = None) -> None:
        self._rows = RowFile(path, header="# " + " ".join(header.split()) + "\n", at=at)
        self._stamps: list[
            NDArray[np.int64]
        ] = []  # not yet formatted: rows one by one would take several times as long
        self._poses: list[NDArray[np.float64]] = []
        self._waiting = 0

    @property
    def path(self) -> Path:
        """The file."""
        return self._rows.path

    @property
    def size(self) -> int:
        """Bytes of the rows so far, all of them on the disk."""
        self._format()
        return self._rows.size

    def append(self, stamp_ns: int, T_frame_body: NDArray[np.float64]) -> None:
        """Append one pose: time [ns] and ``(4, 4)`` float64 ``T_frame_body`` [m]."""
        self.extend(np.array([stamp_ns], dtype=np.int64), T_frame_body[None])

    def extend(self, stamps_ns: NDArray[np.int64], T_frame_body: NDArray[np.float64]) -> None:
        """Append poses: ``(N,)`` int64 times [ns] and ``(N, 4, 4)`` float64 ``T_frame_body`` [m].

        Stamps are written exactly; positions to a nanometre, quaternions to 1e-12, with ``qw >= 0``.
        """
        if T_frame_body.shape != (len(stamps_ns), 4, 4):
            raise ValueError(f"poses have shape {T_frame_body.shape}, expected ({len(stamps_ns)}, 4, 4)")
        self._stamps.append(stamps_ns.copy())
        self._poses.append(T_frame_body.copy())
        self._waiting += len(stamps_ns)
        if len(self._stamps) >= _BATCH or self._waiting >= _BATCH_ROWS:
            self._format()

    def flush(self) -> None:
        """Hand all rows so far to the operating system."""
        self._format()
        self._rows.flush()

    def close(self) -> None:
        """Flush and release the file."""
        try:
            self._format()
        finally:
            self._rows.close()

    def _format(self) -> None:
        if self._stamps:
            stamps, poses = np.concatenate(self._stamps), np.concatenate(self._poses)
            self._stamps, self._poses, self._waiting = [], [], 0
            self._rows.write(_format_rows(stamps, poses))

    def __enter__(self) -> TumWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def write_tum(path: Path | str, trajectory: Trajectory, header: str) -> None:
    """Write a whole trajectory as a TUM file, all of it or nothing; arguments as for `TumWriter`."""
    with atomic_path(path) as temporary, TumWriter(temporary, header) as writer:
        writer.extend(trajectory.stamps_ns, trajectory.T_frame_body)


def read_tum(path: Path | str, frame: str = "map", body: str = "imu") -> Trajectory:
    """Read a TUM trajectory.

    Parameters
    ----------
    path : Path or str
        Rows ``stamp x y z qx qy qz qw`` (seconds, metres), separated by blanks or commas; ``#`` starts a comment.
    frame, body : str
        Names to give the trajectory's frames: the format has none.

    Returns
    -------
    Trajectory
        Stamps exact to the nanosecond; a stamp with more than nine decimals is rounded.

    Raises
    ------
    FormatError
        A row has another number of values, a value is not a number, a quaternion has no length, or stamps run
        backwards; the message gives the line number.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, words in _rows_of(path):
        if len(words) != 8:
            raise FormatError(path, f"line {number} has {len(words)} values, a TUM row has 8: stamp x y z qx qy qz qw")
        try:
            stamps.append(parse_seconds(words[0]))
            rows.append([float(word) for word in words[1:]])
        except ValueError:
            raise FormatError(
                path, f"line {number} holds something that is not a number: {' '.join(words)[:60]!r}"
            ) from None
        lines.append(number)
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    stamps_ns = np.array(stamps, dtype=np.int64)
    _check_rows(path, lines, np.isfinite(values).all(axis=1), "holds a value that is not finite")
    norms = np.linalg.norm(values[:, 3:], axis=1)
    _check_rows(
        path, lines, np.abs(norms - 1.0) < 0.1, "has a quaternion whose length is not 1; the order is qx qy qz qw"
    )
    _check_order(path, lines, stamps_ns)
    T_frame_body = np.tile(np.eye(4), (len(values), 1, 1))
    T_frame_body[:, :3, 3] = values[:, :3]
    T_frame_body[:, :3, :3] = so3.from_quaternion(values[:, 3:])
    return Trajectory(stamps_ns=stamps_ns, T_frame_body=T_frame_body, frame=frame, body=body)


def read_kitti(
    path: Path | str, times: Path | str | NDArray[np.int64] | None = None, frame: str = "map", body: str = "camera"
) -> Trajectory:
    """Read a KITTI odometry trajectory.

    Parameters
    ----------
    path : Path or str
        Text file of rows of 12 numbers: the upper 3x4 of ``T_frame_body``, row by row.
    times : Path, str, (N,) int64 or None
        The file of stamps in seconds, or stamps [ns]. None numbers the poses: pose ``i`` is at ``i`` seconds.
    frame, body : str
        Names to give the trajectory's frames.

    Raises
    ------
    FormatError
        As for `read_tum`; also a rotation that is none (defect above 1e-3), or fewer or more stamps than poses.
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, words in _rows_of(path):
        if len(words) != 12:
            raise FormatError(
                path, f"line {number} has {len(words)} values, a KITTI row has 12: the 3x4 matrix row by row"
            )
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise FormatError(
                path, f"line {number} holds something that is not a number: {' '.join(words)[:60]!r}"
            ) from None
        lines.append(number)
    T_frame_body = np.tile(np.eye(4), (len(rows), 1, 1))
    T_frame_body[:, :3, :] = np.array(rows, dtype=np.float64).reshape(-1, 3, 4)
    R = T_frame_body[:, :3, :3]
    _check_rows(path, lines, np.isfinite(T_frame_body).all(axis=(1, 2)), "holds a value that is not finite")
    defect = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
    proper = (defect < _MAX_ROTATION_DEFECT) & (np.linalg.det(R) > 0)
    _check_rows(path, lines, proper, "holds a matrix whose left 3x3 block is no rotation")
    T_frame_body[:, :3, :3] = so3.project(R)
    stamps_ns = _kitti_stamps(times, len(rows))
    if len(stamps_ns) != len(rows):
        raise FormatError(path, f"holds {len(rows)} poses, but there are {len(stamps_ns)} stamps")
    _check_order(path, lines, stamps_ns)
    return Trajectory(stamps_ns=stamps_ns, T_frame_body=T_frame_body, frame=frame, body=body)


def _kitti_stamps(times: Path | str | NDArray[np.int64] | None, count: int) -> NDArray[np.int64]:
    if times is None:
        return np.arange(count, dtype=np.int64) * _NS
    if isinstance(times, np.ndarray):
        return times.astype(np.int64, casting="safe")
    stamps = []
    for number, words in _rows_of(times):
        try:
            stamps.append(parse_seconds(words[0]))
        except ValueError:
            raise FormatError(
                times, f"line {number} does not begin with a stamp in seconds: {words[0][:60]!r}"
            ) from None
    return np.array(stamps, dtype=np.int64)


def parse_seconds(text: str) -> int:
    """Convert decimal seconds to integer nanoseconds exactly: a float64 would lose 100 ns at today's epoch.

    Parameters
    ----------
    text : str
        Such as ``"1700000000.123456789"``, ``"-0.5"``, ``"1.7e9"``. Digits after the ninth decimal are rounded.

    Raises
    ------
    ValueError
        ``text`` is not a finite decimal number.
    """
    plain = _PLAIN_SECONDS.fullmatch(text) if len(text) <= _MAX_STAMP else None
    if plain:
        ns = int(plain[2]) * _NS + int(plain[3].ljust(9, "0"))
        ns = -ns if plain[1] == "-" else ns
    else:
        try:  # slow and rare: exponents, no point, more than nine decimals
            ns = whole_ns(text, _NS)
        except (ArithmeticError, ValueError) as error:
            raise ValueError(f"not a number of seconds: {text[:60]!r}") from error
    if not _MIN_NS <= ns <= _MAX_NS:
        raise ValueError(f"too many seconds for 64-bit nanoseconds: {text[:60]!r}")
    return ns


def whole_ns(text: str, scale: int) -> int:
    """Return a decimal number times ``scale`` as a whole number.

    Raises
    ------
    ValueError, ArithmeticError
        It is no finite number, or its exponent alone is beyond 64 bits: to write it out would take for ever.
    """
    if len(text) > _MAX_STAMP:
        raise ValueError(f"a number of {len(text)} characters")
    number = Decimal(text)
    if not number.is_finite() or number.adjusted() > _MAX_STAMP:
        raise ValueError(f"not a time: {text!r}")
    return int((number * scale).to_integral_value())


def _rows_of(path: Path | str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and words of each line that is neither blank nor a comment."""
    try:
        text = plain_file(path, TABLE).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"is not a text file (byte {error.start} is not UTF-8)") from None
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words:
            yield number, words


def _check_rows(path: Path | str, lines: list[int], conditions: ArrayLike, complaint: str) -> None:
    good = np.asarray(conditions)
    if not good.all():
        raise FormatError(path, f"line {lines[int(np.argmin(good))]} {complaint}")


def _check_order(path: Path | str, lines: list[int], stamps_ns: NDArray[np.int64]) -> None:
    if len(lines) == 0:
        raise FormatError(path, "holds no poses")
    steps = np.diff(stamps_ns)
    if len(steps) and steps.min() < 0:
        worst = int(np.argmax(steps < 0))
        raise FormatError(
            path,
            f"line {lines[worst + 1]} is {-steps[worst] / _NS:.6f} s before line {lines[worst]}; sort the rows by time",
        )
