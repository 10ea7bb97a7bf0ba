"""NumPy archives from anybody: what they hold is never more than what the file weighs, and no program."""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from heliograph.guard.files import plain_file

__all__ = ["read_npz"]

_SUFFIX = ".npy"
_KINDS = "biufU"
_MAX_ENTRIES = 1_000_000
_HEADERS: dict[tuple[int, int], Callable[..., tuple[Any, ...]]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
_DAMAGE = (
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,  # of zipfile: encrypted, or of a version that nobody writes
    OverflowError,
    RecursionError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(source: Path | BinaryIO) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive that `numpy.savez` wrote, by name.

    Parameters
    ----------
    source : Path or binary file
        Its arrays are stored as they are: a compressed one could stand for any amount.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is no such archive or is damaged; the message says how, on one line.
    """
    try:
        with zipfile.ZipFile(plain_file(source) if isinstance(source, Path) else source) as archive:
            entries = archive.infolist()
            _check(entries, _size_of(source))
            return {entry.filename.removesuffix(_SUFFIX): _array(archive, entry) for entry in entries}
    except _DAMAGE as error:
        said = " ".join(str(error).split())[:200]
        raise ValueError(said or type(error).__name__) from error


def _size_of(source: Path | BinaryIO) -> int:
    if isinstance(source, Path):
        return source.stat().st_size
    return source.seek(0, io.SEEK_END)


def _check(entries: list[zipfile.ZipInfo], size: int) -> None:
    """Refuse what would take more memory than the file takes on disk."""
    if len(entries) > _MAX_ENTRIES or sum(entry.file_size for entry in entries) > size:
        raise ValueError("it promises more than the file holds")
    packed = next((e.filename for e in entries if e.compress_type != zipfile.ZIP_STORED), None)
    if packed is not None:
        raise ValueError(f"'{packed}' in it is compressed, which Heliograph's own archives are not")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    data = archive.read(entry)
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = _HEADERS.get(version)
    if read_header is None:
        raise ValueError(f"'{entry.filename}' in it is of version {version} of the format")
    shape, in_columns, dtype = read_header(stream)
    if dtype.kind not in _KINDS or dtype.names is not None:
        raise ValueError(f"'{entry.filename}' in it holds {dtype}, not numbers or text")
    count, content = math.prod(shape), memoryview(data)[stream.tell() :]
    if any(length < 0 for length in shape) or count * max(dtype.itemsize, 1) > max(len(content), 1):
        raise ValueError(f"'{entry.filename}' in it is of shape {shape}, but has {len(content)} bytes")
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    flat = np.frombuffer(content, dtype, count).copy()
    return np.asarray(flat.reshape(shape[::-1]).transpose() if in_columns else flat.reshape(shape))
