"""What can still be read of a ROS 2 bag's SQLite file that is cut off or damaged."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import tempfile
from pathlib import Path

from heliograph.errors import FormatError
from heliograph.guard.files import plain_file
from heliograph.guard.limits import ReadLimits
from heliograph.guard.scratch import ScratchFolder

__all__ = ["PaddedCopy"]

HEADER_BYTES = 100
_MAX_BYTES = 1 << 42  # of the copy, most of them a hole


class PaddedCopy:
    """A temporary copy of a damaged file that is as long as its header says, the lost pages blank.

    SQLite refuses a file that is shorter than its header says; of the copy every row before the lost pages can be read.
    (File format: sqlite.org/fileformat2.html, 1.3.)

    Parameters
    ----------
    path : Path
        The file; at least its header must be whole.
    limits : ReadLimits
        How much of the temporary folder's disk is left free.

    Raises
    ------
    FormatError
        There is no room for the copy.
    sqlite3.Error
        The header is not whole.
    """

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        self._folder = ScratchFolder()
        self.path = self._folder.path / "padded.db3"
        try:
            size, room = path.stat().st_size, shutil.disk_usage(self._folder.path).free - limits.reserve
            if size > room:
                raise FormatError(
                    path,
                    f"is damaged, and {tempfile.gettempdir()} has no room for the {size / 1e6:.0f} MB that repairing "
                    "it takes; set TMPDIR to a folder on a larger disk",
                )
            shutil.copyfile(path, self.path)
            _pad(self.path)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove the copy."""
        self._folder.close()


def _pad(path: Path) -> None:
    """Make a database file as long as its header says."""
    with plain_file(path).open("rb") as file:
        header = file.read(HEADER_BYTES)
    if len(header) < HEADER_BYTES:
        raise sqlite3.DatabaseError("shorter than its header")
    (page,) = struct.unpack_from(">H", header, 16)
    (pages,) = struct.unpack_from(">I", header, 28)
    wanted = (65536 if page == 1 else page) * pages
    if path.stat().st_size < wanted <= _MAX_BYTES:
        os.truncate(path, wanted)
