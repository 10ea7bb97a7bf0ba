"""What a run was made of and what it made: files by name, size and checksum."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from heliograph.guard.files import plain_file

__all__ = ["fingerprint", "hashed_files", "hashed_inputs"]

_BLOCK = 1 << 20  # bytes read at once
_SAMPLES, _SAMPLE = 16, 1 << 16  # pieces of a large file that stand for it, and their length [bytes]
_WHOLE = 1 << 30  # recordings up to this size are read as a whole by default [bytes]
_LISTED = 1000  # files of a folder that are named one by one


def hashed_files(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Return name, size and SHA-256 of each file that is there."""
    return [
        {"name": path.name, "bytes": path.stat().st_size, "sha256": _sha256(path)} for path in paths if path.is_file()
    ]


def hashed_inputs(paths: Sequence[Path], how: str = "auto") -> list[dict[str, Any]]:
    """Return name, size and checksum of a recording's files.

    Parameters
    ----------
    paths : sequence of Path
        As given on the command line; of a folder, the files below it.
    how : str
        ``"full"``: ``sha256`` of each file. ``"sampled"``: ``sampled_sha256`` of 16 pieces of 64 KiB, first and last
        among them. ``"auto"``: full up to 1 GiB in all. ``"none"``: size only.
    """
    files = _files(paths)
    if how == "auto":
        how = "full" if sum(file.stat().st_size for _, file in files) <= _WHOLE else "sampled"
    if len(files) > _LISTED:
        return [_together(files, how)]
    return [{"name": name, "bytes": file.stat().st_size, **_checksum(file, how)} for name, file in files]


def fingerprint(paths: Sequence[Path]) -> dict[str, str]:
    """Return what tells a recording from another, at no cost worth speaking of: name to size and sampled checksum."""
    return {
        entry["name"]: f"{entry['bytes']} bytes, {str(entry['sampled_sha256'])[:16]}"
        for entry in hashed_inputs(paths, "sampled")
    }


def _files(paths: Sequence[Path]) -> list[tuple[str, Path]]:
    """Return the files of a recording with the names that they have below what was given."""
    found: list[tuple[str, Path]] = []
    for path in paths:
        if path.is_dir():
            below = sorted(file for file in path.rglob("*") if file.is_file() and not _is_of_a_run(file, path))
            found += [(file.relative_to(path.parent).as_posix(), file) for file in below]
        elif path.is_file():
            found.append((path.name, path))
    return found


def _is_of_a_run(file: Path, top: Path) -> bool:
    """Return whether a file lies in the folder of a run, such as the one that is being written."""
    return any(
        (folder / "run.json").is_file() and (folder / "config.toml").is_file()
        for folder in file.parents
        if folder == top or top in folder.parents
    )


def _checksum(file: Path, how: str) -> dict[str, str]:
    if how == "full":
        return {"sha256": _sha256(file)}
    return {"sampled_sha256": _sampled(file)} if how == "sampled" else {}


def _together(files: Sequence[tuple[str, Path]], how: str) -> dict[str, Any]:
    """Return one entry for very many files: a checksum over names, sizes and what is asked of the contents."""
    whole = hashlib.sha256()
    for name, file in files:
        checksum = "".join(_checksum(file, how).values())
        whole.update(f"{name} {file.stat().st_size} {checksum}\n".encode())
    kind = "sampled_sha256" if how == "sampled" else "sha256"
    size = sum(file.stat().st_size for _, file in files)
    return {"name": f"{len(files)} files", "bytes": size, **({kind: whole.hexdigest()} if how != "none" else {})}


def _sha256(path: Path) -> str:
    whole = hashlib.sha256()
    with plain_file(path).open("rb") as file:
        while block := file.read(_BLOCK):
            whole.update(block)
    return whole.hexdigest()


def _sampled(path: Path) -> str:
    size = path.stat().st_size
    if size <= _SAMPLES * _SAMPLE:
        return _sha256(path)
    whole = hashlib.sha256(str(size).encode())
    with plain_file(path).open("rb") as file:
        for k in range(_SAMPLES):
            file.seek(k * (size - _SAMPLE) // (_SAMPLES - 1))
            whole.update(file.read(_SAMPLE))
    return whole.hexdigest()
