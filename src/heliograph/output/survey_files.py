"""Files of a survey that was delivered into a run's folder: what they are called, and how they go with their run."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path

__all__ = ["ACCURACY", "remove_survey"]

ACCURACY = "accuracy.json"
_NAMES = re.compile(
    r"map_\w+\.(laz|e57)|map_\w+/(-?\d+_-?\d+\.laz|index\.json)|trajectory_\w+\.csv|trajectory\.(gpx|kml|sbet|smrmsg)"
)


def remove_survey(folder: Path) -> None:
    """Remove what ``accuracy.json`` lists, and itself: another run is to stand there. What it does not list stays."""
    try:
        files = json.loads((folder / ACCURACY).read_text(encoding="utf-8"))["files"]
        ours = [name for name in files if _NAMES.fullmatch(name)]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return
    for name in (*ours, ACCURACY):
        (folder / name).unlink(missing_ok=True)
    for name in {Path(name).parent for name in ours} - {Path()}:
        with suppress(OSError):  # what is not ours stays, and its folder
            (folder / name).rmdir()
