"""Files that are files: a pipe never ends where nobody writes, a device never ends, and a hole weighs nothing."""

from __future__ import annotations

import errno
import stat
from pathlib import Path

__all__ = ["SETTINGS", "TABLE", "plain_file"]

SETTINGS = 64_000_000
"""Bytes of settings, plans, mountings and accounts, of which the largest are a hundredth of it."""
TABLE = 4_000_000_000
"""Bytes of what is read as a whole: a table of ten hours at 1 kHz is as large."""

_GIVEN = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""Where a shell puts what it pipes, as in ``heliograph solve <(zcat graph.gz)``."""
_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def plain_file(path: Path | str, max_bytes: int | None = None) -> Path:
    """Return a path that may be opened to be read: of a file, or of a folder, of which opening will tell.

    A folder from somebody else may hold a pipe, or a link to a device: opening the one waits, reading the other fills
    the memory, and so does a file of a terabyte that is one hole. Every reader asks here first; what a shell pipes into
    a command is taken.

    Parameters
    ----------
    path : Path or str
    max_bytes : int, optional
        Bytes that it may hold, where it is read as a whole.

    Raises
    ------
    OSError
        It is a pipe, a socket, a device or too large, or cannot be looked at (there is none, or it is a link to
        itself); ``strerror`` says which.
    """
    path = Path(path)
    found = path.stat()
    kind = next((name for is_kind, name in _KINDS if is_kind(found.st_mode)), None)
    if kind is not None and not str(path).startswith(_GIVEN):
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    if max_bytes is not None and found.st_size > max_bytes:
        raise OSError(
            errno.EFBIG,
            f"it holds {found.st_size / 1e6:.0f} MB, and {max_bytes / 1e6:.0f} MB are read at most",
            str(path),
        )
    return path
