"""Copies in the temporary folder that no kill leaves there for good."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["ScratchFolder"]

_PREFIX = "heliograph-"
_LOCK = ".held"


class ScratchFolder:
    """A temporary folder that is locked while its process lives, however that ends.

    ``kill -9`` leaves it behind, with a copy of a recording in it perhaps; the next process that makes one finds it
    without a holder and removes it.

    Raises
    ------
    OSError
        The temporary folder cannot be written.
    """

    def __init__(self) -> None:
        _remove_left(Path(tempfile.gettempdir()))
        self._folder = tempfile.TemporaryDirectory(prefix=_PREFIX)
        self.path = Path(self._folder.name)
        self._file = -1
        if fcntl is None:  # pragma: no cover - Windows
            return
        # Locked before it bears the name by which another process would look whether it is.
        unnamed = self.path / f"{_LOCK}-"
        with suppress(OSError):  # a file system that cannot lock: the folder is left alone by others, without a lock
            self._file = os.open(unnamed, os.O_RDWR | os.O_CREAT, 0o600)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            unnamed.rename(self.path / _LOCK)

    def close(self) -> None:
        """Remove it; a second call does nothing."""
        self._folder.cleanup()
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _remove_left(parent: Path) -> None:
    """Remove what processes of this user left that were killed: a lock that nobody holds tells."""
    if fcntl is None:  # pragma: no cover - Windows
        return
    for lock in parent.glob(f"{_PREFIX}*/{_LOCK}"):
        with suppress(OSError):  # another process removes it, holds it, or it is another user's
            file = os.open(lock, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(file).st_uid == os.getuid():
                    shutil.rmtree(lock.parent, ignore_errors=True)
            finally:
                os.close(file)
