"""The PLY format (Stanford, G. Turk): the columns of its ``vertex`` element."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import DataError, FormatError
from heliograph.guard.files import plain_file
from heliograph.io.files.records import columns_of, require_bytes, write_records

__all__ = ["ply_header", "read_ply", "write_ply"]

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
_NAMES = {np.dtype(code): name for name, code in _TYPES.items()}
_SIZED = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
          "float64": "f8"}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_MAX_HEADER_LINES = 1000
_MAX_DIGITS = 18  # of a number of points


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]]


def write_ply(path: Path, table: Mapping[str, NDArray[np.generic]], comments: Sequence[str]) -> None:
    """Write columns as a binary little-endian PLY; `DataError` for a type that PLY does not have."""
    with path.open("wb") as file:
        file.write(ply_header({name: column.dtype for name, column in table.items()}, len(table["x"]), comments))
        write_records(file, table)


def ply_header(types: Mapping[str, np.dtype[np.generic]], count: int, comments: Sequence[str]) -> bytes:
    """Return the header for columns of some types; `DataError` for a type that PLY does not have."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines.append(f"element vertex {count}")
    for name, dtype in types.items():
        if dtype not in _NAMES:
            raise DataError(f"column {name} is {dtype}, which PLY cannot hold; convert it or write a .pcd")
        lines.append(f"property {_NAMES[dtype]} {name}")
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def read_ply(path: Path) -> dict[str, NDArray[np.generic]]:
    """Read the vertex columns of a PLY file in any of its three encodings; `FormatError` if it is damaged."""
    with plain_file(path).open("rb") as file:
        order, dtype, count = _read_header(path, file)
        if order == "=":
            return _read_ascii(path, file, dtype, count)
        require_bytes(path, file, count, dtype.itemsize)
        records = np.fromfile(file, dtype=dtype, count=count)
    if len(records) < count:
        raise FormatError(path, f"ends after {len(records)} of {count} points; the file is truncated")
    return columns_of(records)


def _read_header(path: Path, file: BinaryIO) -> tuple[str, np.dtype[np.void], int]:
    """Return byte order, record type and number of the vertices, and leave ``file`` at the first one."""
    order, elements = "", list[_Element]()
    for words in _header_lines(path, file):
        match words:
            case ["format", encoding, _] if encoding in _ORDERS:
                order = _ORDERS[encoding]
            case ["element", name, count] if count.isdecimal() and len(count) <= _MAX_DIGITS:
                elements.append(_Element(name, int(count), []))
            case ["property", *kinds, name] if elements and kinds:
                elements[-1].properties.append((name, " ".join(kinds)))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise FormatError(path, f"has a header line that is not PLY: {' '.join(words)[:60]!r}")
    if not order:
        raise FormatError(path, "has a PLY header without 'format'")
    vertex = _vertex(path, elements)
    try:
        return (
            order,
            np.dtype([(name, order + _ply_type(path, kind)) for name, kind in vertex.properties]),
            vertex.count,
        )
    except ValueError as error:
        raise FormatError(path, f"has a faulty PLY header: {error}") from error


def _vertex(path: Path, elements: Sequence[_Element]) -> _Element:
    """Return the element ``vertex``, before which no other may have data."""
    for element in elements:
        if element.name == "vertex":
            return element
        if element.count:
            raise FormatError(path, f"has the element {element.name!r} before 'vertex', which is not supported")
    raise FormatError(path, "has a PLY header without 'element vertex'")


def _header_lines(path: Path, file: BinaryIO) -> Iterator[list[str]]:
    """Yield the words of each header line between ``ply`` and ``end_header``."""
    if file.readline(16).strip() != b"ply":
        raise FormatError(path, "is not a PLY file: it does not begin with 'ply'")
    for _ in range(_MAX_HEADER_LINES):
        words = file.readline(4096).decode("latin-1").split()
        if words[:1] == ["end_header"]:
            return
        yield words
    raise FormatError(path, "has a PLY header without 'end_header'; the file is truncated")


def _ply_type(path: Path, kind: str) -> str:
    if kind.startswith("list"):
        raise FormatError(path, "has a list property in its vertices, which is not supported")
    code = _TYPES.get(kind) or _SIZED.get(kind)
    if code is None:
        raise FormatError(path, f"has a property of the unknown type {kind!r}")
    return code


def _read_ascii(path: Path, file: BinaryIO, dtype: np.dtype[np.void], count: int) -> dict[str, NDArray[np.generic]]:
    rows = []
    names = dtype.names or ()
    for number in range(count):
        words = file.readline().split()
        if len(words) < len(names):
            raise FormatError(path, f"point {number} of {count} has {len(words)} values of {len(names)}; truncated?")
        rows.append(tuple(words[: len(names)]))
    try:
        values = np.array(rows, dtype=np.float64).reshape(count, len(names))
    except ValueError as error:
        raise FormatError(path, f"holds a point that is not numbers: {str(error)[:80]}") from None
    with np.errstate(invalid="ignore", over="ignore"):  # what a type cannot hold is as wrong as the file has it
        return {name: values[:, i].astype(dtype[name]) for i, name in enumerate(names)}
