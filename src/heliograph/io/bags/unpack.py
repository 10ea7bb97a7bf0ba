"""Compressed bytes to plain ones, never more than was asked for: a small file may stand for any amount of zeros."""

from __future__ import annotations

import bz2
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame

from heliograph.guard.files import plain_file
from heliograph.guard.limits import ReadLimits

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = ["ZSTD_MAGIC", "UnpackTally", "unpack", "unpack_file"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_PIECE = 1 << 20  # bytes that are unpacked at once
_DAMAGE = (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError)
_HEAD = 18  # bytes of a zstd frame's header at most


class UnpackTally:
    """How much the parts of one file have unpacked to: many that are allowed each are too much together.

    Parameters
    ----------
    limits : ReadLimits
        Together they may be ``ratio`` times what they weigh, and ``chunk`` bytes always.
    """

    def __init__(self, limits: ReadLimits) -> None:
        self._limits = limits
        self._packed = self._unpacked = 0

    def room(self, packed: int) -> int:
        """Return the bytes that a part of a given size may unpack to."""
        return round(self._limits.chunk + self._limits.ratio * (self._packed + packed)) - self._unpacked

    def add(self, packed: int, unpacked: int) -> None:
        """Count a part."""
        self._packed += packed
        self._unpacked += unpacked


def unpack(
    kind: str,
    data: bytes | memoryview,
    limits: ReadLimits,
    *,
    size: int | None = None,
    cut_off: bool = False,
    tally: UnpackTally | None = None,
) -> memoryview:
    """Return the content of a chunk or message.

    Parameters
    ----------
    kind : str
        ``"zstd"``, ``"lz4"``, ``"bz2"``; ``""`` and ``"none"``: it is as it is.
    data : bytes or memoryview
        The compressed bytes.
    limits : ReadLimits
        Their ``chunk`` is the most that comes out.
    size : int or None
        Its size as the container declares it; what is longer or shorter is damaged.
    cut_off : bool
        The data end too early: as much as can be had is returned.
    tally : UnpackTally, optional
        Counts of the file's other parts, which this one adds to.

    Raises
    ------
    ValueError
        Unknown compression, damage, or more content than is declared or allowed; the message says which.
    """
    if kind in ("", "none"):
        return memoryview(data)
    if kind not in ("zstd", "lz4", "bz2"):
        raise ValueError(f"its compression '{kind}' is not known")
    if size is not None and size > limits.chunk:
        raise ValueError(limits.chunk_message(size))
    room = limits.chunk if tally is None else min(limits.chunk, tally.room(len(data)))
    if size is not None and size > room:
        raise ValueError(limits.ratio_message())
    content = _content(kind, data, limits, size, room, cut_off)
    if tally is not None:
        tally.add(len(data), len(content))
    if size is not None and len(content) != size and not cut_off:
        raise ValueError(f"it holds {len(content)} bytes instead of {size}")
    return content


def _content(
    kind: str, data: bytes | memoryview, limits: ReadLimits, size: int | None, room: int, cut_off: bool
) -> memoryview:
    """Return what comes out, of an unknown ``size`` at most ``room`` bytes; else it is an error."""
    max_bytes = room if size is None else size
    at_once = min(max_bytes + 1, _PIECE if size is None else max_bytes + 1)
    found: list[bytes] = []
    length = 0
    try:
        for piece in _pieces(kind, bytes(data) if kind == "lz4" else data, at_once):
            found.append(piece)
            length += len(piece)
            if length > max_bytes:
                raise ValueError(_too_much(limits, size, room))
    except _DAMAGE as error:
        if not (cut_off and 0 < length <= max_bytes):
            raise ValueError(str(error) or type(error).__name__) from error
    return memoryview(found[0] if len(found) == 1 else b"".join(found))


def _too_much(limits: ReadLimits, size: int | None, room: int) -> str:
    if size is not None:
        return f"it holds more than its {size} bytes"
    return limits.chunk_message(room) if room == limits.chunk else limits.ratio_message()


def _pieces(kind: str, data: bytes | memoryview, at_once: int) -> Iterator[bytes]:
    """Yield the content piece by piece, of all frames that follow each other."""
    while data:
        stream = _decompressor(kind)
        piece = stream.decompress(data, at_once)
        while True:
            if piece:
                yield piece
            if stream.eof:
                break
            before, piece = len(piece), stream.decompress(b"", at_once)
            if not piece and not before:
                raise ValueError("it is cut off")
        data = stream.unused_data or b""


def _decompressor(kind: str) -> Any:  # noqa: ANN401 - three libraries, one interface
    if kind == "bz2":
        return bz2.BZ2Decompressor()
    return zstd.ZstdDecompressor() if kind == "zstd" else lz4.frame.LZ4FrameDecompressor()


def unpack_file(path: Path, target: Path, limits: ReadLimits) -> str:
    """Write the content of a zstd file to another one.

    Returns
    -------
    str
        Why it ends early; empty where it is whole.

    Raises
    ------
    ValueError
        There is more in it than is allowed, or than the disk of ``target`` has room for.
    OSError
        One of the files cannot be read or written.
    """
    packed = path.stat().st_size
    room = shutil.disk_usage(target.parent).free - limits.reserve
    with plain_file(path).open("rb") as source:
        declared = _declared(source.read(_HEAD))
        _check_room(declared, packed, room, target.parent, limits)
        source.seek(0)
        with target.open("wb") as out:
            return _copy(source, out, packed, room, limits)


def _copy(source: BinaryIO, out: BinaryIO, packed: int, room: int, limits: ReadLimits) -> str:
    written = 0
    try:
        with zstd.open(source, "rb") as content:
            while piece := content.read(_PIECE):
                written += len(piece)
                _check_room(written, packed, room, Path(out.name).parent, limits)
                out.write(piece)
    except (zstd.ZstdError, EOFError) as error:
        return str(error) or "it is cut off"
    return ""


def _declared(head: bytes) -> int:
    try:
        return int(zstd.get_frame_info(head).decompressed_size or 0)
    except (zstd.ZstdError, ValueError):
        return 0  # the file is damaged, which unpacking tells


def _check_room(size: int, packed: int, room: int, folder: Path, limits: ReadLimits) -> None:
    if size > max(limits.chunk, limits.ratio * packed):
        raise ValueError(
            f"it unpacks to more than {limits.ratio:g} times its size, which no recording does; if it is to be "
            f"trusted, unpack it with `zstd -d`, or raise input.max_unpack_ratio"
        )
    if size > room:
        raise ValueError(
            f"{folder} has room for {max(room, 0) / 1e6:.0f} MB of its content, which is more; set TMPDIR to a folder "
            "on a larger disk, or unpack it with `zstd -d`"
        )
