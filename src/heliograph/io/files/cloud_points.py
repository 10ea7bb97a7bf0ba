"""The coordinates of a cloud in any of its usual files: PLY, PCD, LAS, LAZ, and text with x, y, z in a row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError, HeliographError, MissingDependencyError
from heliograph.guard.boundary import reason
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.clouds import read_columns
from heliograph.io.files.las_header import check_las

__all__ = ["POINT_SUFFIXES", "read_points"]

_TEXT = (".xyz", ".txt", ".csv", ".asc", ".pts")
_LAS = (".las", ".laz")
POINT_SUFFIXES = (".ply", ".pcd", *_LAS, *_TEXT)


def read_points(path: Path | str) -> NDArray[np.float32] | NDArray[np.float64]:
    """Read the points of a file, its suffix choosing the format.

    Parameters
    ----------
    path : Path or str
        ``.ply``, ``.pcd``, ``.las``, ``.laz`` (needs laspy), or text (``.xyz``, ``.txt``, ``.csv``, ``.asc`` or
        ``.pts``): a point a row, its first three numbers x, y, z, apart by blanks, commas or semicolons; ``#`` and
        ``//`` begin a comment, and a first row without numbers is a header.

    Returns
    -------
    (N, 3) float32 or float64
        As stored [m], NaN included: float64 where the file has more than single precision.

    Raises
    ------
    FormatError
        The file is not there, of another kind, or damaged.
    MissingDependencyError
        LAS or LAZ without laspy.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _LAS:
        return _read_las(path)
    if suffix in _TEXT:
        return _read_text(path)
    if suffix not in POINT_SUFFIXES:
        raise FormatError(path, f"is not a cloud that can be read; give one of {', '.join(POINT_SUFFIXES)}")
    columns = read_columns(path)
    xyz = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return xyz if any(columns[axis].dtype.itemsize > 4 for axis in "xyz") else xyz.astype(np.float32)


def _read_las(path: Path) -> NDArray[np.float64]:
    try:
        import laspy
    except ImportError as error:
        raise MissingDependencyError(
            f"reading {path.suffix} needs laspy: pip install 'heliograph[las]'; or convert it to .ply or .pcd"
        ) from error
    try:
        check_las(path)
        # One thread: the decoder of several takes the sizes of its buffers from the file's table of chunks.
        with laspy.open(str(path), laz_backend=(laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip)) as file:
            return np.asarray(file.read().xyz, dtype=np.float64)
    except HeliographError:
        raise
    except OSError as error:
        raise FormatError(path, reason("cannot be read", error)) from error
    except (
        BaseException
    ) as error:  # laspy has errors of its own; its decoder in Rust ends in one that is no `Exception`
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        raise FormatError(path, reason("is not a LAS file that can be read", error)) from error


def _read_text(path: Path) -> NDArray[np.float64]:
    try:
        lines = plain_file(path, TABLE).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror}") from error
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].partition("//")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words[:3]])
        except ValueError as error:
            if not rows and number <= 2:  # a header
                continue
            raise FormatError(path, f"line {number} is not a point: '{line.strip()[:40]}'") from error
        if len(rows[-1]) < 3:
            if len(rows) == 1 and len(words) == 1:  # .pts begins with the number of its points
                rows.pop()
                continue
            raise FormatError(path, f"line {number} has {len(words)} numbers; a point needs x, y and z")
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
