"""A text file that grows by whole rows, and stays one of whole rows whatever interrupts it."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from types import TracebackType

from heliograph.atomic import output_error, output_errors
from heliograph.errors import FormatError

__all__ = ["RowFile", "opened_at"]

_FLUSH_BYTES = 1 << 16


def opened_at(path: Path, at: int) -> io.FileIO:
    """Return a file that is there, opened to go on behind its first ``at`` bytes; what follows them is taken out.

    Raises
    ------
    FormatError
        It is shorter.
    OutputError
        It cannot be written.
    """
    with output_errors(path):
        file = io.FileIO(path, "r+")
        size = os.fstat(file.fileno()).st_size
        if size >= at:
            file.truncate(at)
            file.seek(at)
            return file
        file.close()
    raise FormatError(path, f"holds {size} bytes, and {at} of it were written; run anew with --overwrite")


class RowFile:
    """Append-only text file of complete rows.

    Rows collect in memory and are written by `flush`, by every 64 KiB, and by `close`. If a write fails half-way (full
    disk, Ctrl-C), the file is cut back to its last complete row before the error goes on.

    Parameters
    ----------
    path : Path or str
        File to create; an existing one is replaced.
    header : str
        First rows, written at once, so that a path which cannot be written fails here.
    at : int, optional
        Bytes of a file that is there: rows go on behind them, and what follows is taken out [bytes].

    Raises
    ------
    OutputError
        The file cannot be created or written; names the path and a remedy.
    """

    def __init__(self, path: Path | str, header: str = "", *, at: int | None = None) -> None:
        self.path = Path(path)
        self._pending: list[str] = []
        self._pending_bytes = 0
        if at is not None:
            self._file = opened_at(self.path, at)
            return
        with output_errors(self.path):
            self._file = io.FileIO(self.path, "w")
        try:
            self.write(header)
            self.flush()
        except BaseException:
            self._file.close()
            raise

    @property
    def size(self) -> int:
        """Bytes of the rows so far, all of them handed to the operating system and put on the disk itself."""
        self.flush()
        with output_errors(self.path):
            os.fsync(self._file.fileno())
        return os.lseek(self._file.fileno(), 0, os.SEEK_CUR)

    def write(self, rows: str) -> None:
        """Append ``rows``: text that ends with a newline."""
        if not rows:
            return
        if not rows.endswith("\n"):
            raise ValueError("rows must end with a newline, or an interruption could leave half a row")
        self._pending.append(rows)
        self._pending_bytes += len(rows)
        if self._pending_bytes >= _FLUSH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        data = "".join(self._pending).encode()
        self._pending.clear()
        self._pending_bytes = 0
        if not data:
            return
        start = os.lseek(self._file.fileno(), 0, os.SEEK_CUR)
        try:
            view = memoryview(data)
            while view:
                view = view[self._file.write(view) :]
        except BaseException as error:
            kept = self._cut(start, data)
            if isinstance(error, OSError):
                raise output_error(self.path, error) from error
            self._pending = [data[kept:].decode()]  # an interruption loses no row: `close` writes the rest
            raise

    def close(self) -> None:
        """Flush and release the file; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self.flush()
        finally:
            with output_errors(self.path):
                self._file.close()

    def _cut(self, start: int, data: bytes) -> int:
        """Drop the incomplete row at the end: ``data`` was being written at ``start``; return how much of it stays."""
        written = max(os.fstat(self._file.fileno()).st_size - start, 0)
        kept = data[:written].rfind(b"\n") + 1
        with contextlib.suppress(OSError):  # a device or pipe cannot be cut; the first error is the one to report
            self._file.truncate(start + kept)
            self._file.seek(start + kept)
        return kept

    def __enter__(self) -> RowFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
