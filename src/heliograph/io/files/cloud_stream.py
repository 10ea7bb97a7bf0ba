"""Clouds written block by block: the header's count is put in at the end, so that memory holds one block."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import DataError
from heliograph.io.files.las import extra_columns, las_header, las_writer, load_laspy, sixteen_bits
from heliograph.io.files.pcd import pcd_header
from heliograph.io.files.ply import ply_header
from heliograph.io.files.records import write_records

__all__ = ["CloudStream", "LasStream", "PcdStream", "PlyStream"]

Table = Mapping[str, NDArray[np.generic]]
_MAX_COUNT = 10**18  # points, by whose header the room for the true one is left


class CloudStream(Protocol):
    """An open file of points."""

    def append(self, table: Table) -> None:
        """Write a block: the columns by the names and types that the stream was opened with."""
        ...

    def close(self) -> None:
        """Put in the number of points and release the file; a second call does nothing."""
        ...


class _RecordStream:
    """PLY and PCD: a header with the count, and then records."""

    def __init__(
        self, path: Path, types: Mapping[str, np.dtype[np.generic]], comments: Sequence[str], brightest: float
    ) -> None:
        del brightest  # they hold any number
        self._types, self._comments, self._count = types, tuple(comments), 0
        self._length = len(self._header(_MAX_COUNT, 0))
        self._file = path.open("wb")
        self._file.write(self._header(_MAX_COUNT, 0))

    def append(self, table: Table) -> None:
        columns = {name: np.asarray(table[name], dtype=dtype) for name, dtype in self._types.items()}
        write_records(self._file, columns)
        self._count += len(columns["x"])

    def close(self) -> None:
        if self._file.closed:
            return
        try:
            self._file.seek(0)
            self._file.write(self._header(self._count, self._length - len(self._header(self._count, 0))))
        finally:
            self._file.close()

    def _header(self, count: int, blanks: int) -> bytes:
        """Return a header that is ``blanks`` longer than it need be: in a comment, where nobody minds them."""
        return self._written(self._types, count, [*self._comments, "-" * (1 + blanks)])

    _written: ClassVar = staticmethod(ply_header)


class PlyStream(_RecordStream):
    """A binary PLY."""


class PcdStream(_RecordStream):
    """A binary PCD."""

    _written: ClassVar = staticmethod(pcd_header)


class LasStream:
    """LAS or LAZ as `heliograph.io.files.las.write_las` has it, in millimetres from the frame's origin."""

    def __init__(
        self, path: Path, types: Mapping[str, np.dtype[np.generic]], comments: Sequence[str], brightest: float
    ) -> None:
        self._laspy, self._types, self._brightest = load_laspy(path.suffix), types, brightest
        self._header = las_header(self._laspy, types, comments)
        self._open = ExitStack()
        self._writer: Any = self._open.enter_context(las_writer(path, self._header))

    def append(self, table: Table) -> None:
        """Write a block."""
        xyz = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
        if bad := int(np.count_nonzero(~np.isfinite(xyz).all(axis=1))):
            raise DataError(f"{bad} of {len(xyz)} points are not finite, which LAS cannot hold; write a .ply")
        record = self._laspy.ScaleAwarePointRecord.zeros(len(xyz), header=self._header)
        record.x, record.y, record.z = xyz.T
        if "intensity" in self._types:
            record.intensity = sixteen_bits(table["intensity"], self._brightest)
        for name in extra_columns(self._types):
            record[name] = table[name]
        try:
            self._writer.write_points(record)
        except BaseException:
            self._open.__exit__(*sys.exc_info())  # which tells why, where the disk is full
            raise

    def close(self) -> None:
        """Complete the header."""
        self._open.close()
