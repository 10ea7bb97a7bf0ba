"""Files of a survey that was delivered into a run's folder: what they are called, and how they go with their run."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from heliograph.guard.files import SETTINGS, plain_file

__all__ = ["ACCURACY", "remove_survey", "replaced_files"]

ACCURACY = "accuracy.json"
_NAMES = re.compile(
    r"map_\w+\.(laz|e57)|map_\w+/(-?\d+_-?\d+\.laz|index\.json)|trajectory_\w+\.csv|trajectory\.(gpx|kml|sbet|smrmsg)"
)


def remove_survey(folder: Path) -> None:
    """Remove what ``accuracy.json`` lists, and itself: another run is to stand there. What it does not list stays."""
    ours = _listed(folder)
    if ours is not None:
        _remove(folder, [*ours, ACCURACY])


def replaced_files(folder: Path, stem: str, names: Sequence[str]) -> list[str]:
    """Remove an earlier survey's map in the same system, and return what else of earlier ones is there.

    Parameters
    ----------
    folder : Path
        The run's.
    stem : str
        What names of the map in this system begin with.
    names : sequence of str
        Files that have just been written: they stay.
    """
    earlier = [name for name in _listed(folder) or () if name not in names and (folder / name).exists()]
    stale = [name for name in earlier if re.match(rf"{re.escape(stem)}[./]", name)]
    _remove(folder, stale)
    return [name for name in earlier if name not in stale]


def _listed(folder: Path) -> list[str] | None:
    """Return the files that ``accuracy.json`` lists and that can be a survey's; None without one."""
    try:
        files = json.loads(plain_file(folder / ACCURACY, SETTINGS).read_text(encoding="utf-8"))["files"]
        return [name for name in files if _NAMES.fullmatch(name)]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def _remove(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        (folder / name).unlink(missing_ok=True)
    for emptied in {Path(name).parent for name in names} - {Path()}:
        with suppress(OSError):  # what is not ours stays, and its folder
            (folder / emptied).rmdir()
