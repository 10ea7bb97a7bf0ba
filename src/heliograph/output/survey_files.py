"""Files of a survey that was delivered into a run's folder: what they are called, and how they go with their run."""

from __future__ import annotations

import json
import re
from pathlib import Path

__all__ = ["ACCURACY", "remove_survey"]

ACCURACY = "accuracy.json"
_NAMES = re.compile(r"map_\w+\.laz|trajectory_\w+\.csv|trajectory\.(gpx|kml)")


def remove_survey(folder: Path) -> None:
    """Remove what ``accuracy.json`` lists, and itself: another run is to stand there. What it does not list stays."""
    try:
        files = json.loads((folder / ACCURACY).read_text(encoding="utf-8"))["files"]
        ours = [name for name in files if _NAMES.fullmatch(name)]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return
    for name in (*ours, ACCURACY):
        (folder / name).unlink(missing_ok=True)
