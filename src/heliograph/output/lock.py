"""A folder that one run writes at a time."""

from __future__ import annotations

import os
from pathlib import Path

from heliograph.atomic import LOCK
from heliograph.errors import OutputError

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["FolderLock"]


class FolderLock:
    """Holds a folder for this process; it is free again when the process ends, however that comes about.

    Parameters
    ----------
    folder : Path
        Exists.

    Raises
    ------
    OutputError
        Another run writes into it; the message names its process.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self._file: int | None = None
        if fcntl is None:  # pragma: no cover - Windows
            return
        while self._file is None:
            try:
                file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            except OSError:  # a file system without it: the run's own files will tell what is wrong
                return
            if not self._taken(file, folder):
                return
            if self._is_there(file):
                self._file = file
            else:  # released and removed by its holder in between: the next one would make another
                os.close(file)
        try:
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)
        except OSError:  # a full disk; the lock holds without the number
            return

    def _is_there(self, file: int) -> bool:
        """Whether an open file is the one that the path names."""
        try:
            return os.path.samestat(os.fstat(file), self._path.stat())
        except FileNotFoundError:
            return False

    @staticmethod
    def _taken(file: int, folder: Path) -> bool:
        """Lock a file; False where its file system cannot, and the file is closed then."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(file, 20, 0).decode(errors="replace").strip()
            os.close(file)
            raise OutputError(
                f"another run (process {holder or 'unknown'}) is writing into {folder}; wait for it, or choose another "
                "folder with -o"
            ) from None
        except OSError:  # a network file system that cannot lock
            os.close(file)
            return False
        return True

    def release(self) -> None:
        """Free the folder; a second call does nothing."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None
