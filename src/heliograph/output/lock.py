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
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:  # a file system without it: the run's own files will tell what is wrong
            return
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
            return
        self._file = file
        try:
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        except OSError:  # a full disk; the lock holds without the number
            return

    def release(self) -> None:
        """Free the folder; a second call does nothing."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None
