"""Point clouds as files: PLY, PCD and LAS/LAZ.

PLY and PCD are coded here on NumPy record arrays: plyfile is GPL, trimesh widens to float64 and drops columns, pypcd4
pulls in pydantic. LZF (compressed PCD) and LAS/LAZ come from python-neo-lzf (BSD-3) and laspy (BSD-2, an extra).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze, frozen
from heliograph.atomic import atomic_path
from heliograph.errors import FormatError, OutputError
from heliograph.io.files.cloud_stream import CloudStream, LasStream, PcdStream, PlyStream
from heliograph.io.files.las import write_las
from heliograph.io.files.pcd import read_pcd, write_pcd
from heliograph.io.files.ply import read_ply, write_ply

__all__ = ["CLOUD_SUFFIXES", "CloudFile", "cloud_stream", "read_cloud", "read_columns", "write_cloud"]

CLOUD_SUFFIXES = (".ply", ".pcd")
_WRITERS: Mapping[str, Callable[..., None]] = {
    ".ply": write_ply,
    ".pcd": write_pcd,
    ".las": write_las,
    ".laz": write_las,
}
_STREAMS: Mapping[str, Callable[..., CloudStream]] = {
    ".ply": PlyStream,
    ".pcd": PcdStream,
    ".las": LasStream,
    ".laz": LasStream,
}
_INTENSITY_NAMES = ("intensity", "reflectivity", "i", "scalar_intensity", "intensities", "reflectance")


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudFile:
    """A cloud as its file holds it.

    Parameters
    ----------
    points : (N, 3) float32
        As stored, NaN included [m].
    intensity : (N,) float32 or None
        In the sensor's own unit.
    columns : mapping of str to (N,) array
        Every other column under its own name and type: ``t``, ``time``, ``ring`` ...
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    columns: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.points)


def write_cloud(
    path: Path | str,
    points: NDArray[np.float32],
    intensity: NDArray[np.float32] | None = None,
    columns: Mapping[str, NDArray[np.generic]] | None = None,
    *,
    comments: Sequence[str] = (),
) -> None:
    """Write a cloud; the suffix of ``path`` chooses the format. All of it is written or nothing.

    Parameters
    ----------
    path : Path or str
        ``.ply`` (binary little-endian), ``.pcd`` (binary), ``.las`` or ``.laz`` (millimetres; needs laspy).
    points : (N, 3) float32
        Coordinates [m].
    intensity : (N,) float32 or None
        Stored as ``intensity``; LAS holds 16 bits, see `heliograph.io.files.las.write_las`.
    columns : mapping of str to (N,) array or None
        More columns, in this order; PLY has no 64-bit integers.
    comments : sequence of str
        Lines for the header (LAS keeps the first 32 characters of the first).

    Raises
    ------
    OutputError
        The file cannot be written, or the suffix is none of the four.
    MissingDependencyError
        LAS or LAZ without laspy; the message names the install command.
    DataError
        An array has the wrong shape or dtype.
    """
    path = Path(path)
    writer = _writer(path, _WRITERS)
    points = frozen("points", points, np.float32, (None, 3))
    table: dict[str, NDArray[np.generic]] = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
    if intensity is not None:
        table["intensity"] = frozen("intensity", intensity, np.float32, (len(points),))
    for name, column in (columns or {}).items():
        table[name] = frozen(name, column, column.dtype, (len(points),))
    with atomic_path(path) as temporary:
        writer(temporary, table, _clean(comments))


@contextmanager
def cloud_stream(
    path: Path | str,
    types: Mapping[str, np.dtype[np.generic]],
    *,
    comments: Sequence[str] = (),
    brightest: float = 0.0,
) -> Iterator[CloudStream]:
    """Write a cloud block by block, of which nobody knows the length before: all of it is written or nothing.

    Parameters
    ----------
    path : Path or str
        As for `write_cloud`.
    types : mapping of str to dtype
        The columns, ``x``, ``y``, ``z`` among them.
    comments : sequence of str
        As for `write_cloud`.
    brightest : float
        Largest intensity that is to come: it decides how LAS stores it.

    Yields
    ------
    CloudStream
        Takes the blocks.

    Raises
    ------
    OutputError, MissingDependencyError, DataError
        As for `write_cloud`.
    """
    path = Path(path)
    opened = _writer(path, _STREAMS)
    with atomic_path(path) as temporary:
        stream = opened(temporary, types, _clean(comments), brightest)
        try:
            yield stream
        finally:
            stream.close()


Found = TypeVar("Found")


def _writer(path: Path, known: Mapping[str, Found]) -> Found:
    if path.suffix.lower() not in known:
        raise OutputError(f"cannot write {path}: a cloud's suffix must be one of {', '.join(known)}")
    return known[path.suffix.lower()]


def _clean(comments: Sequence[str]) -> list[str]:
    return [" ".join(comment.split()).encode("ascii", "replace").decode() for comment in comments]


def read_columns(path: Path | str) -> dict[str, NDArray[np.generic]]:
    """Read a PLY or PCD file as named columns of equal length, in the file's order and types (native byte order).

    Raises
    ------
    FormatError
        Not a PLY or PCD file, damaged, or without ``x``, ``y``, ``z``.
    """
    path = Path(path)
    reader = {".ply": read_ply, ".pcd": read_pcd}.get(path.suffix.lower())
    if reader is None:
        raise FormatError(path, "is not a cloud that can be read; give a .ply or .pcd file")
    try:
        columns = reader(path)
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror}") from error
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise FormatError(path, f"has no column {', '.join(missing)}; its columns are {', '.join(columns) or 'none'}")
    return columns


def read_cloud(path: Path | str) -> CloudFile:
    """Read a PLY (ascii, binary) or PCD (ascii, binary, compressed) file.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    CloudFile
        ``intensity`` is the column ``intensity``, ``reflectivity`` or ``i`` (first found), as float32.

    Raises
    ------
    FormatError
        As for `read_columns`.
    """
    columns = read_columns(path)
    points = np.stack([columns.pop(axis).astype(np.float32) for axis in "xyz"], axis=1)
    lowered = {name.lower(): name for name in columns}
    name = next((lowered[known] for known in _INTENSITY_NAMES if known in lowered), None)
    intensity = None if name is None else columns.pop(name).astype(np.float32)
    return CloudFile(points=points, intensity=intensity, columns=columns)
