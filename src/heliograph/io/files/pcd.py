"""The PCD format of the Point Cloud Library, version 0.7: ascii, binary and binary_compressed."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import lzf
import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError
from heliograph.guard.files import plain_file
from heliograph.guard.limits import ReadLimits
from heliograph.io.files.records import columns_of, require_bytes, write_records

__all__ = ["pcd_header", "read_pcd", "write_pcd"]

_MAX_HEADER_LINES = 200
_MAX_POINTS = 1 << 31
_MAX_LZF_RATIO = 128  # three bytes stand for 264 at most
_PLAUSIBLE_LZF_RATIO = 20  # of a large cloud; a small one may be all zeros


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    fields: list[tuple[str, str, int]]  # name, NumPy type, count
    points: int
    encoding: str

    @property
    def size(self) -> int:
        """Bytes of a point; NumPy's own count of them is of 32 bits."""
        return sum(np.dtype(code).itemsize * count for _, code, count in self.fields)

    @property
    def dtype(self) -> np.dtype[np.void]:
        return np.dtype([(name, code, (count,)) if count > 1 else (name, code) for name, code, count in self.fields])


def write_pcd(path: Path, table: Mapping[str, NDArray[np.generic]], comments: Sequence[str]) -> None:
    """Write columns as a binary PCD."""
    with path.open("wb") as file:
        file.write(pcd_header({name: column.dtype for name, column in table.items()}, len(table["x"]), comments))
        write_records(file, table)


def pcd_header(types: Mapping[str, np.dtype[np.generic]], count: int, comments: Sequence[str]) -> bytes:
    """Return the header for columns of some types."""
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {comment}" for comment in comments),
        "VERSION 0.7",
        "FIELDS " + " ".join(types),
        "SIZE " + " ".join(str(dtype.itemsize) for dtype in types.values()),
        "TYPE " + " ".join(dtype.kind.upper() for dtype in types.values()),
        "COUNT " + " ".join("1" for _ in types),
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def read_pcd(path: Path) -> dict[str, NDArray[np.generic]]:
    """Read the columns of a PCD file; padding (fields named ``_``) and descriptors (COUNT > 1) are left out.

    Raises
    ------
    FormatError
        The header is none of PCD, or the data are shorter than it promises.
    """
    with plain_file(path).open("rb") as file:
        header = _read_header(path, file)
        if header.encoding == "ascii":
            return _read_ascii(path, file, header)
        if header.encoding == "binary_compressed":
            return _read_compressed(path, file, header)
        require_bytes(path, file, header.points, header.size)
        records = np.fromfile(file, dtype=header.dtype, count=header.points)
    if len(records) < header.points:
        raise FormatError(path, f"ends after {len(records)} of {header.points} points; the file is truncated")
    return columns_of(records[[name for name, _, count in header.fields if _is_column(name, count)]])


def _is_column(name: str, count: int) -> bool:
    """Tell columns from descriptors and padding."""
    return count == 1 and not name.startswith("_")


def _read_header(path: Path, file: BinaryIO) -> _Header:
    entries: dict[str, list[str]] = {}
    for _ in range(_MAX_HEADER_LINES):
        line = file.readline(1 << 16)
        words = line.decode("latin-1").split()
        if not line:
            break
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
            if words[0].upper() == "DATA":
                break
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "DATA") if not entries.get(key)]
    if missing:
        raise FormatError(path, f"is not a PCD file: the header has no {', '.join(missing)}")
    try:
        return _parse_header(entries)
    except KeyError as error:
        raise FormatError(path, f"is not a PCD file: the header has no {error.args[0]}") from error
    except (ValueError, IndexError, TypeError) as error:
        raise FormatError(path, f"has a faulty PCD header: {error}") from error


def _parse_header(entries: Mapping[str, list[str]]) -> _Header:
    names, sizes, kinds = entries["FIELDS"], entries["SIZE"], entries["TYPE"]
    counts = entries.get("COUNT") or ["1"] * len(names)
    if not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    if "POINTS" in entries:
        points = int(entries["POINTS"][0])
    else:
        points = int(entries["WIDTH"][0]) * int(entries.get("HEIGHT", ["1"])[0])
    if not 0 <= points < _MAX_POINTS:
        raise ValueError(f"{points} points")
    encoding = entries["DATA"][0].lower()
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"DATA {encoding} is none of ascii, binary, binary_compressed")
    fields = []
    for index, (name, size, kind, count) in enumerate(zip(names, sizes, kinds, counts, strict=True)):
        code = f"<{kind.lower()}{int(size)}"
        if kind.lower() not in ("f", "i", "u") or np.dtype(code).itemsize != int(size) or int(count) < 1:
            raise ValueError(f"field {name} has TYPE {kind} SIZE {size} COUNT {count}")
        fields.append((f"_{index}" if name == "_" else name, code, int(count)))
    return _Header(fields=fields, points=points, encoding=encoding)


def _read_compressed(path: Path, file: BinaryIO, header: _Header) -> dict[str, NDArray[np.generic]]:
    """Read LZF data, which PCL stores column by column."""
    sizes = file.read(8)
    if len(sizes) < 8:
        raise FormatError(path, "ends inside its header; the file is truncated")
    packed, unpacked = struct.unpack("<II", sizes)
    data = file.read(packed)
    expected = header.size * header.points
    if len(data) < packed or unpacked < expected:
        raise FormatError(path, f"holds {len(data)} of {packed} compressed bytes; the file is truncated")
    if unpacked > _MAX_LZF_RATIO * packed:
        raise FormatError(path, f"promises {unpacked} bytes of {packed} compressed ones, more than LZF can hold")
    if unpacked > max(ReadLimits().chunk, _PLAUSIBLE_LZF_RATIO * packed):
        raise FormatError(
            path,
            f"unpacks to {unpacked / 1e6:.0f} MB, more than {_PLAUSIBLE_LZF_RATIO} times its weight, which no cloud so "
            "large does; if it is to be trusted, write it uncompressed",
        )
    try:
        raw = lzf.decompress(data, unpacked) if packed else b""
    except (ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise FormatError(path, f"does not unpack ({error}); the file is damaged") from error
    if raw is None or len(raw) < expected:
        raise FormatError(path, f"unpacks to {len(raw or b'')} bytes, expected {expected}; the file is damaged")
    columns, start = {}, 0
    for name, code, count in header.fields:
        if _is_column(name, count):
            column = np.frombuffer(raw, dtype=code, count=header.points, offset=start)
            columns[name] = column.astype(column.dtype.newbyteorder("="))
        start += np.dtype(code).itemsize * count * header.points
    return columns


def _read_ascii(path: Path, file: BinaryIO, header: _Header) -> dict[str, NDArray[np.generic]]:
    width = sum(count for _, _, count in header.fields)
    words = file.read().split()
    if len(words) < width * header.points:
        raise FormatError(path, f"ends after {len(words) // width} of {header.points} points; the file is truncated")
    table = np.array(words[: width * header.points], dtype=object).reshape(header.points, width)
    columns, start = {}, 0
    for name, code, count in header.fields:
        if _is_column(name, count):
            dtype = np.dtype(code).newbyteorder("=")
            try:
                # Integers go through int: a float64 would round nanosecond stamps.
                convert = float if dtype.kind == "f" else int
                columns[name] = np.array([convert(word) for word in table[:, start]], dtype=dtype)
            except (ValueError, OverflowError) as error:
                raise FormatError(path, f"column {name} holds something that is not a number: {error}") from None
        start += count
    return columns
