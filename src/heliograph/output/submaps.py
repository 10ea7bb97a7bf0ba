"""The points of a run on disk, keyframe by keyframe, for as long as their poses may still change.

The file begins with a magic word and the cubes' edge. Each submap that follows is a header with its length and a
checksum, then four columns: sums of offsets, sums of intensity, counts and cubes, and where the rays of the keyframe's
own scan ended. Numbers are little-endian. Cubes are counted from the submap's lowest corner and, like counts, take two
bytes where they fit; an intensity that is zero all over takes none. That makes 20 to 24 bytes a cube. Rays are in
centimetres from the sensor, 6 bytes each.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen
from heliograph.atomic import output_error, output_errors
from heliograph.errors import FormatError
from heliograph.guard.files import plain_file
from heliograph.io.files.rows import opened_at
from heliograph.maps import MapCells, Sight

__all__ = ["Submap", "SubmapFile", "located_submaps", "read_sight", "read_submaps", "read_voxel"]

_MAGIC = b"HGSUBM02"
_FILE = struct.Struct("<8sd")  # magic, edge of the cubes [m]
# Checksum of all behind it, cells, stamp, pose, corner, widths, intensity?, rays, the sensor's way.
_HEADER = struct.Struct("<IIq16d3iBBBxI6d")
_CHECKED = struct.calcsize("<I")  # where what the checksum covers begins
_Columns: TypeAlias = tuple[tuple[str, int], ...]
_NARROW = 1 << 16
_RAY_STEP = 0.01  # [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Submap:
    """What was seen from one keyframe until the next.

    Parameters
    ----------
    stamp_ns : int
        Time of the keyframe [ns].
    T_odom_imu : (4, 4) float64
        Its pose as the odometry gave it [m].
    cells : MapCells
        The points, summed in cubes of the odom frame.
    sight : Sight or None
        Rays of the keyframe's own scan, in odom.
    """

    stamp_ns: int
    T_odom_imu: NDArray[np.float64]
    cells: MapCells
    sight: Sight | None = None

    def __post_init__(self) -> None:
        value = frozen("T_odom_imu", self.T_odom_imu, np.float64, (4, 4), finite=True)
        object.__setattr__(self, "T_odom_imu", value)


class SubmapFile:
    """Append-only file of submaps; interrupted at any time, all but the last are whole and are read.

    Parameters
    ----------
    path : Path
        File to create; an existing one is replaced.
    voxel : float
        Edge of the cubes [m].
    at, count : int
        Bytes of a file that is there, and submaps in them: it goes on behind those.

    Raises
    ------
    OutputError
        The file cannot be created or written; what a failed write left of a submap is cut off.
    """

    def __init__(self, path: Path, voxel: float, *, at: int | None = None, count: int = 0) -> None:
        self.path, self.count, self.nbytes = path, count, at or 0
        if at is not None:
            self._file = opened_at(path, at)
            return
        with output_errors(path):
            self._file = io.FileIO(path, "w")
        self._write([_FILE.pack(_MAGIC, voxel)])

    def append(self, submap: Submap) -> None:
        """Write a submap and hand it to the operating system."""
        self._write(_packed(submap))
        self.count += 1

    def settle(self) -> None:
        """Have the operating system put it on the disk itself."""
        with output_errors(self.path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Release the file; a second call does nothing."""
        with output_errors(self.path):
            self._file.close()

    def _write(self, parts: list[bytes]) -> None:
        try:
            for part in parts:
                view = memoryview(part).cast("B")
                while view:
                    view = view[self._file.write(view) :]
        except BaseException as error:
            with contextlib.suppress(OSError):
                self._file.truncate(self.nbytes)
                self._file.seek(self.nbytes)
            if isinstance(error, OSError):
                raise output_error(self.path, error) from error
            raise
        self.nbytes += sum(len(part) for part in parts)


def read_voxel(path: Path | str) -> float:
    """Return the edge of the cubes in a file of submaps [m].

    Raises
    ------
    FormatError
        The file cannot be read or is none of submaps.
    """
    try:
        with plain_file(path).open("rb") as file:
            start = file.read(_FILE.size)
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror}); check the path") from error
    if len(start) < _FILE.size or not start.startswith(_MAGIC):
        raise FormatError(path, "no file of submaps; name the submaps.bin of a run")
    return float(_FILE.unpack(start)[1])


def read_submaps(path: Path | str) -> Iterator[Submap]:
    """Yield the submaps of a file one by one, up to the first that is not whole.

    Raises
    ------
    FormatError
        The file cannot be read or is none of submaps.
    """
    for _, submap in located_submaps(path):
        yield submap


def located_submaps(path: Path | str) -> Iterator[tuple[int, Submap]]:
    """Yield the same with the place of each in the file, for `read_sight`."""
    read_voxel(path)
    with plain_file(path).open("rb") as file:
        file.seek(at := _FILE.size)
        while (submap := _read(file)) is not None:
            yield at, submap
            at = file.tell()


def read_sight(path: Path | str, at: int) -> Sight | None:
    """Return the rays of the submap at a place that `located_submaps` found whole, without reading the rest of it."""
    with plain_file(path).open("rb") as file:
        file.seek(at)
        _, count, _, *numbers = _HEADER.unpack(file.read(_HEADER.size))
        *columns, (kind, length) = _columns(count, *numbers[19:23])
        file.seek(sum(np.dtype(kind).itemsize * length for kind, length in columns), io.SEEK_CUR)
        return _sight(np.frombuffer(file.read(np.dtype(kind).itemsize * length), kind), numbers)


def _packed(submap: Submap) -> list[bytes]:
    cells = submap.cells
    corner = cells.cubes.min(axis=0) if len(cells) else np.zeros(3, np.int32)
    cubes = cells.cubes - corner
    narrow_cubes = bool(cubes.max(initial=0) < _NARROW)
    narrow_counts = bool(cells.counts.max(initial=0) < _NARROW)
    has_intensity = bool(cells.intensity.any())
    rays, way = _rays(submap.sight)
    body = [
        cells.sums.astype("<f4", copy=False).tobytes(),
        cells.intensity.astype("<f4", copy=False).tobytes() if has_intensity else b"",
        cells.counts.astype("<u2" if narrow_counts else "<u4").tobytes(),
        cubes.astype("<u2" if narrow_cubes else "<u4").tobytes(),
        rays.astype("<i2").tobytes(),
    ]
    fields = (len(cells), submap.stamp_ns, *submap.T_odom_imu.ravel(), *corner.tolist(), narrow_cubes, narrow_counts)
    header = _HEADER.pack(0, *fields, has_intensity, len(rays), *way)
    checksum = zlib.crc32(header[_CHECKED:])
    for part in body:
        checksum = zlib.crc32(part, checksum)
    return [checksum.to_bytes(_CHECKED, "little") + header[_CHECKED:], *body]


def _rays(sight: Sight | None) -> tuple[NDArray[np.float32], list[float]]:
    """Return a sight's rays in steps, without those that are too long for two bytes, and the sensor's way."""
    if sight is None:
        return np.zeros((0, 3), np.float32), [0.0] * 6
    steps = np.rint(sight.ends / np.float32(_RAY_STEP))
    return steps[(np.abs(steps) < 1 << 15).all(axis=1)], [*sight.origin.tolist(), *sight.start.tolist()]


def _read(file: io.BufferedReader) -> Submap | None:
    """Return the submap at the file's position, None where there is no whole one."""
    header = file.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    checksum, count, stamp_ns, *numbers = _HEADER.unpack(header)
    narrow_cubes, narrow_counts, has_intensity, rays = numbers[19:23]
    columns = _columns(count, narrow_cubes, narrow_counts, has_intensity, rays)
    size = sum(np.dtype(kind).itemsize * length for kind, length in columns)
    if size > os.fstat(file.fileno()).st_size - file.tell():  # cut off, or a number that a stranger wrote
        return None
    body = file.read(size)
    if zlib.crc32(body, zlib.crc32(header[_CHECKED:])) != checksum:
        return None
    arrays, begin = [], 0
    for kind, length in columns:
        arrays.append(np.frombuffer(body, kind, length, begin))
        begin += arrays[-1].nbytes
    sums, intensity, counts, cubes, steps = arrays
    cells = MapCells(
        cubes=cubes.reshape(-1, 3).astype(np.int32) + np.array(numbers[16:19], dtype=np.int32),
        sums=sums.reshape(-1, 3).astype(np.float32, copy=False),
        intensity=intensity.astype(np.float32, copy=False) if has_intensity else np.zeros(count, np.float32),
        counts=counts.astype(np.float32),
    )
    T_odom_imu = np.array(numbers[:16]).reshape(4, 4)
    return Submap(stamp_ns=stamp_ns, T_odom_imu=T_odom_imu, cells=cells, sight=_sight(steps, numbers))


def _columns(count: int, narrow_cubes: int, narrow_counts: int, has_intensity: int, rays: int) -> _Columns:
    """Return type and length of each column behind a header."""
    return (
        ("<f4", 3 * count),
        ("<f4", count if has_intensity else 0),
        ("<u2" if narrow_counts else "<u4", count),
        ("<u2" if narrow_cubes else "<u4", 3 * count),
        ("<i2", 3 * rays),
    )


def _sight(steps: NDArray[np.int16], numbers: list[float]) -> Sight | None:
    """Return the rays behind a header, None where there are none."""
    if not len(steps):
        return None
    ends = steps.reshape(-1, 3).astype(np.float32) * np.float32(_RAY_STEP)
    return Sight(origin=np.array(numbers[23:26]), start=np.array(numbers[26:29]), ends=ends)
