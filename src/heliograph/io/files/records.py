"""Columns of equal length to interleaved binary records and back, shared by the cloud formats."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError

__all__ = ["columns_of", "require_bytes", "write_records"]

_BLOCK = 1 << 18


def write_records(file: BinaryIO, table: Mapping[str, NDArray[np.generic]]) -> None:
    """Write the columns as packed little-endian records, in blocks so that memory stays small."""
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in table.items()])
    count = len(next(iter(table.values())))
    block = np.empty(min(count, _BLOCK), dtype=dtype)
    for start in range(0, count, _BLOCK):
        used = block[: min(_BLOCK, count - start)]
        for name, column in table.items():
            used[name] = column[start : start + len(used)]
        file.write(used.data)


def require_bytes(path: Path, file: BinaryIO, count: int, size: int) -> None:
    """Refuse a header that promises more records than the rest of the file holds, before memory is taken for them.

    Raises
    ------
    FormatError
        It does; the message says how many there are.
    """
    left = os.fstat(file.fileno()).st_size - file.tell()
    if count * size > left:
        raise FormatError(
            path, f"ends after {left // max(size, 1)} of {count} points; the file is truncated or damaged"
        )


def columns_of(records: NDArray[np.void]) -> dict[str, NDArray[np.generic]]:
    """Return each field of a record array as a contiguous column in native byte order."""
    names = records.dtype.names or ()
    return {name: np.ascontiguousarray(records[name], dtype=records.dtype[name].newbyteorder("=")) for name in names}
