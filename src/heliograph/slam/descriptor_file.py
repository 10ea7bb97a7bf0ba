"""Descriptors of keyframes on disk, one row of bytes after the other: a detector is made anew from them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from heliograph.atomic import output_errors
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.slam.places import Descriptor

__all__ = ["DescriptorFile"]

_LARGEST = 1 << 24  # bytes of a descriptor


class DescriptorFile:
    """Rows of one length, appended as keyframes are described; the first line tells the length.

    Parameters
    ----------
    path : Path
        The file; it is made, or made anew, with the first row.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: int | None = None

    def append(self, descriptor: Descriptor) -> None:
        """Write a row.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        row = descriptor.tobytes()
        with output_errors(self.path):
            if self._file is None:
                self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
                row = f"{len(row)}\n".encode() + row
            view = memoryview(row)
            while view:
                view = view[os.write(self._file, view) :]

    def cut(self, rows: int) -> list[Descriptor]:
        """Return the first rows of a file that an earlier run left, cut off what follows, and go on behind them.

        Raises
        ------
        FormatError
            It does not hold as many.
        """
        if rows == 0:
            return []
        try:
            content = plain_file(self.path, TABLE).read_bytes()
        except OSError as error:
            raise FormatError(self.path, f"cannot be read ({error.strerror}); run with --overwrite") from error
        head, _, body = content.partition(b"\n")
        width = int(head) if head.isdigit() and len(head) < 9 else 0
        if not 0 < width <= _LARGEST or len(body) < rows * width:
            raise FormatError(self.path, f"does not hold {rows} descriptors whole; run with --overwrite")
        with output_errors(self.path):
            self._file = os.open(self.path, os.O_RDWR)
            os.ftruncate(self._file, len(head) + 1 + rows * width)
            os.lseek(self._file, 0, os.SEEK_END)
        return list(np.frombuffer(body, np.uint8, rows * width).reshape(rows, width))

    def settle(self) -> None:
        """Have the operating system put the rows on the disk itself."""
        if self._file is not None:
            os.fsync(self._file)

    def close(self) -> None:
        """Release the file; a later row would begin it anew."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
