"""What a LAS or LAZ file says of itself, held against its size before a decoder is given it.

Decoders reserve memory by counts in the header and in the table of chunks; one ends the process where it cannot.

References
----------
.. [1] ASPRS, "LAS specification 1.4 - R15", 2019, tables 3 to 5.
.. [2] M. Isenburg, "LASzip: lossless compression of LiDAR data", PE&RS 79, 2013.
"""

from __future__ import annotations

import struct
from pathlib import Path

from heliograph.errors import FormatError
from heliograph.guard.files import plain_file

__all__ = ["check_las"]

_MAX_RATIO = 300  # of LAZ above the size below, up to which points on a straight line may take no room at all
_ALWAYS = 64_000_000  # bytes
_COMPRESSED = 0xC0  # bits of the point format that say LAZ
_VLR, _EVLR = 54, 60  # heads of variable length records [bytes]
_LASZIP, _LASZIP_ID = b"laszip encoded", 22204
_ANY_CHUNK = 0xFFFFFFFF  # chunks of sizes of their own
_MAX_CHUNK = 1 << 24  # points of a chunk
_MAX_ITEMS = 32
_LAYERED = 3  # compressor of point formats from 6 on: a chunk begins with a point and the sizes of its layers
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # by the kind of a part; extra bytes (14) have one a byte
_EXTRA = 14


def check_las(path: Path) -> None:
    """Raise where a header promises more than its file can hold.

    Raises
    ------
    FormatError
        The file is no LAS, is cut off, or is forged.
    OSError
        It cannot be read.
    """
    size = path.stat().st_size
    with plain_file(path).open("rb") as file:
        head = file.read(375)
        if len(head) < 227 or head[:4] != b"LASF":
            raise FormatError(path, "is not a LAS file")
        length, data, records, kind, width = struct.unpack_from("<HIIBH", head, 94)
        points = struct.unpack_from("<I", head, 107)[0]
        if head[25] >= 4:
            if len(head) < 375 or length < 375:
                raise FormatError(path, "is not a LAS file: the header is too short for its version")
            start, count = struct.unpack_from("<QI", head, 235)
            points = struct.unpack_from("<Q", head, 247)[0]
            if count and (start > size or count * _EVLR > size - start):
                raise _cut(path, f"{count} records behind the points")
        if not 227 <= length <= data <= size or records * _VLR > data - length:
            raise _cut(path, f"{records} records before the points at byte {data}")
        max_bytes = max(_ALWAYS, _MAX_RATIO * size) if kind & _COMPRESSED else size
        if width < 20 or points * width > max_bytes:
            raise _cut(path, f"{points} points of {width} bytes")
        file.seek(length)
        laszip = _laszip(path, file.read(data - length), records)
        if kind & _COMPRESSED:
            if laszip is None:
                raise FormatError(path, "is compressed, and says nothing of how; the file is damaged")
            _check_laszip(path, laszip, width)
            table, count = _check_chunks(path, data, size, points)
            if struct.unpack_from("<H", laszip)[0] == _LAYERED:
                _check_layers(path, (data + 8, table), count, width, _layers(path, laszip))


def _cut(path: Path, what: str) -> FormatError:
    return FormatError(path, f"promises {what}, more than the file can hold; it is cut off or damaged")


def _laszip(path: Path, records: bytes, count: int) -> bytes | None:
    """Return the record of the compression, after a walk through all records."""
    at, found = 0, None
    for _ in range(count):
        if at + _VLR > len(records):
            raise _cut(path, f"{count} records before the points")
        user, number, length = struct.unpack_from("<16sHH", records, at + 2)
        at += _VLR + length
        if at > len(records):
            raise _cut(path, f"a record of {length} bytes")
        if user.rstrip(b"\0") == _LASZIP and number == _LASZIP_ID:
            found = records[at - length : at]
    return found


def _check_laszip(path: Path, record: bytes, width: int) -> None:
    if len(record) < 34:
        raise _cut(path, "a record of its compression")
    chunk, count = struct.unpack_from("<I", record, 12)[0], struct.unpack_from("<H", record, 32)[0]
    if not 1 <= count <= _MAX_ITEMS or len(record) < 34 + 6 * count:
        raise FormatError(path, f"compresses {count} parts of a point; the file is damaged")
    whole = sum(struct.unpack_from("<H", record, 34 + 6 * k + 2)[0] for k in range(count))
    if whole != width:
        raise FormatError(path, f"compresses points of {whole} bytes where they have {width}; the file is damaged")
    if chunk != _ANY_CHUNK and not 1 <= chunk <= _MAX_CHUNK:
        raise FormatError(path, f"has chunks of {chunk} points; the file is damaged")


def _layers(path: Path, record: bytes) -> int:
    """Return how many layers a chunk has."""
    found = 0
    for k in range(struct.unpack_from("<H", record, 32)[0]):
        kind, size = struct.unpack_from("<HH", record, 34 + 6 * k)
        if kind != _EXTRA and kind not in _LAYERS:
            raise FormatError(path, f"compresses a part of kind {kind} in layers, which has none; the file is damaged")
        found += size if kind == _EXTRA else _LAYERS[kind]
    return found


def _check_layers(path: Path, span: tuple[int, int], count: int, width: int, layers: int) -> None:
    """Walk from chunk to chunk: a decoder reserves what the layers are said to have before it reads them."""
    at, end = span
    head = width + 4 + 4 * layers
    with plain_file(path).open("rb") as file:
        for _ in range(count):
            file.seek(at + width + 4)
            sizes = file.read(4 * layers)
            whole = sum(struct.unpack(f"<{layers}I", sizes)) if len(sizes) == 4 * layers else end
            if at + head + whole > end:
                raise _cut(path, f"a chunk of {whole} bytes at byte {at}")
            at += head + whole


def _check_chunks(path: Path, data: int, size: int, points: int) -> tuple[int, int]:
    """Look at where the table of chunks is, and at how many it counts: none holds less than a point and a byte.

    Returns
    -------
    tuple of int
        Byte of the table, chunks.
    """
    with plain_file(path).open("rb") as file:
        file.seek(data)
        table = int.from_bytes(file.read(8), "little", signed=True)
        if table == -1 and size >= data + 16:  # written as a stream: at the file's end then
            file.seek(size - 8)
            table = int.from_bytes(file.read(8), "little", signed=True)
        if not data + 8 <= table <= size - 8:
            raise _cut(path, f"a table of chunks at byte {table}")
        file.seek(table + 4)
        count = int.from_bytes(file.read(4), "little")
        if count > max(points, 1) or count > size - data:
            raise _cut(path, f"{count} chunks")
    return table, count
