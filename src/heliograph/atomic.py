"""Writing that a full disk, a missing permission or Ctrl-C cannot turn into a broken file."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from heliograph.errors import OutputError

__all__ = [
    "atomic_folder",
    "atomic_path",
    "check_output_directory",
    "output_error",
    "output_errors",
    "remove_partials",
    "write_text",
]

_REMEDIES = {
    errno.ENOSPC: "the disk is full; free some space or choose another folder with -o",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another folder with -o",
    errno.EACCES: "no permission to write there; choose another folder with -o",
    errno.EPERM: "no permission to write there; choose another folder with -o",
    errno.EROFS: "the file system is read-only; choose another folder with -o",
    errno.ENOTDIR: "a part of the path is a file, not a folder; choose another folder with -o",
    errno.EISDIR: "it is a folder, not a file; remove it or choose another folder with -o",
    errno.ENOENT: "its parent folder cannot be made; choose another folder with -o",
    errno.ENAMETOOLONG: "the name is too long for the file system; choose a shorter one with -o",
}

_FOLDER_PARTIAL = re.compile(r"(?<=[/\\])\.\w{8}\.partial[/\\]")
_FILE_PARTIAL = re.compile(r"(?<=[/\\])\.([^/\\]+)\.\w{8}\.partial(\.\w+)?$")
"""What temporary siblings are called; messages name the file that the user knows."""
RUN_MARKER = "run.json"
LOCK = ".heliograph.lock"
"""Stands in a folder while a run writes it; what a killed run left behind locks nothing."""


def output_error(path: Path | str, error: OSError) -> OutputError:
    """Translate an `OSError` of the operating system into an `OutputError` with path, cause and remedy.

    Parameters
    ----------
    path : Path or str
        The file or folder that was to be written.
    error : OSError
        What the operating system said.
    """
    path = _FOLDER_PARTIAL.sub("", _FILE_PARTIAL.sub(r"\1\2", str(path)))
    reason = _REMEDIES.get(error.errno or 0, f"{error.strerror or error}; choose another folder with -o")
    return OutputError(f"cannot write {path}: {reason}")


@contextmanager
def output_errors(path: Path | str) -> Iterator[None]:
    """Raise `OutputError` for every `OSError` inside the block."""
    try:
        yield
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary sibling of ``path`` to write to; it takes the place of ``path`` when the block ends well.

    On any exception, Ctrl-C included, the temporary file is removed and ``path`` stays as it was. The sibling has the
    same suffix, so that writers which choose the format by name work on it.

    Parameters
    ----------
    path : Path or str
        The final file. Its folder must exist.

    Raises
    ------
    OutputError
        For any `OSError` inside the block (full disk, no permission, read-only file system); names ``path`` and remedy.
    """
    path = Path(path)
    with output_errors(path):
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:64]}.", suffix=f".partial{path.suffix}", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            _adopt_default_mode(temporary)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


@contextmanager
def atomic_folder(path: Path | str) -> Iterator[Path]:
    """Yield a temporary folder inside of ``path``; its files take their places in ``path`` when the block ends well.

    On any exception the temporary folder is removed and ``path`` stays as it was: files that belong together are
    written all, or none. A power loss between the renames, which take no room, is the only way to have some.

    Parameters
    ----------
    path : Path or str
        The folder, which exists.

    Raises
    ------
    OutputError
        For any `OSError` inside the block; names ``path`` and remedy.
    """
    path = Path(path)
    with output_errors(path):
        temporary = Path(tempfile.mkdtemp(prefix=".", suffix=".partial", dir=path))
        try:
            yield temporary
            for file in sorted(temporary.iterdir()):
                _adopt_default_mode(file)
                file.replace(path / file.name)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def remove_partials(folder: Path | str) -> None:
    """Remove temporary siblings that killed processes left in a folder; whoever calls it holds the folder alone."""
    for path in Path(folder).glob(".*"):
        if path.is_dir() and not path.is_symlink() and _FOLDER_PARTIAL.search(f"/{path.name}/"):
            shutil.rmtree(path, ignore_errors=True)
        elif _FILE_PARTIAL.search(f"/{path.name}"):
            path.unlink(missing_ok=True)


def _adopt_default_mode(path: Path) -> None:
    """Give ``path`` the mode of an ordinary new file: mkstemp makes files that only the owner may read."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` as UTF-8 to ``path``, all of it or nothing."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_output_directory(path: Path | str, overwrite: bool = False) -> Path:
    """Make the folder ``path`` ready for a run's results.

    A missing folder is created with its parents; an empty one is used; one that holds anything is refused without
    ``overwrite``. Nothing is deleted here even then, files are only replaced later: a mistyped ``-o`` must not cost
    anybody their data.

    Parameters
    ----------
    path : Path or str
        The folder.
    overwrite : bool
        Allow a non-empty folder.

    Returns
    -------
    Path
        The folder, which exists and is writable.

    Raises
    ------
    OutputError
        It is not empty (the message names ``--overwrite``), is not a folder, or cannot be written.
    """
    path = Path(path)
    with output_errors(path):
        if path.exists() and not path.is_dir():
            raise OutputError(f"cannot write {path}: it is a file, not a folder; choose another folder with -o")
        path.mkdir(parents=True, exist_ok=True)
        entries = sum(1 for entry in path.iterdir() if entry.name != LOCK)
        if entries and not overwrite:
            kind = "holds an earlier run" if (path / RUN_MARKER).exists() else "is not empty"
            raise OutputError(
                f"{path} {kind} ({entries} entries); add --overwrite to replace it or choose another folder with -o"
            )
        with tempfile.TemporaryFile(dir=path) as probe:  # permission bits do not tell about read-only mounts
            probe.write(b"0")
        if shutil.disk_usage(path).free == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return path
