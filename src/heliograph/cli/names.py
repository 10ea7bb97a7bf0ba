"""Names of what a command writes where none is given: after the recording, and no earlier result's."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain, count
from pathlib import Path

__all__ = ["default_folder", "title", "unused"]

_GENERIC_NAMES = ("recording", "bag", "data", "rosbag2")  # say nothing without the folder that they lie in


def title(recording: Path) -> str:
    """Return what a recording is called in a report: with the folder that it lies in, where its name says nothing."""
    path = recording.resolve()
    return path.stem if path.stem not in _GENERIC_NAMES else f"{path.parent.name}/{path.stem}"


def default_folder(recordings: list[Path], suffix: str) -> Path:
    """Return the folder that is named after a recording, such as ``drive_heliograph``."""
    path = recordings[0].resolve()
    return Path(f"{path.parent.name if path.stem in _GENERIC_NAMES else path.stem}_{suffix}")


def _holds_something(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def unused(first: Path, *, again: bool, taken: Callable[[Path], bool] = _holds_something) -> Path:
    """Return the first name that no earlier result has: with a number behind it from the second on.

    Parameters
    ----------
    first : Path
        The name without a number.
    again : bool
        The command goes on with, or replaces, the last result of that name.
    taken : callable
        Whether a folder holds a result; by default one that is not empty does.
    """
    last = first
    for name in chain([first], (first.with_name(f"{first.name}_{number}") for number in count(2))):
        if not taken(name):
            return last if again else name
        last = name
    return last
