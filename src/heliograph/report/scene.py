"""The map in three dimensions, to be turned: points, path, loops and sigmas."""

from __future__ import annotations

import base64
import csv
import json
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.guard.files import TABLE, plain_file
from heliograph.output.record import RunRecord
from heliograph.report.colors import HEIGHT
from heliograph.report.raster import extent

__all__ = ["loop_lines", "scene"]

MAX_POINTS = 100_000  # what a phone turns without a pause, and 1.6 MB in the page
_MAX_PATH = 4_000
_ELLIPSES = 12
_SIGMAS = 3.0


def scene(record: RunRecord, ceiling: float | None = None) -> tuple[str, str]:
    """Return the section with the view and the scripts that end the page; nothing without a map.

    It is drawn when it is opened: a reader who does not open it waits for nothing.

    Parameters
    ----------
    record : RunRecord
        A finished run.
    ceiling : float, optional
        Height above which points hide the way, and are left out [m].
    """
    if not len(record.points_map) or not len(record.scans):
        return "", ""
    data = json.dumps(_traces(record, ceiling), separators=(",", ":"), allow_nan=False)
    script = files("heliograph.report").joinpath("scene.js").read_text(encoding="utf-8")
    section = (
        '<section><details id="scene"><summary>The map in three dimensions, to be turned</summary>'
        '<div id="scene-view" tabindex="0" role="application" aria-label="The map in three dimensions: arrow keys turn '
        'it, plus and minus zoom, Home begins again"></div>'
        '<p class="note">Drag or arrow keys turn, pinch, scroll, + and - zoom, Shift and drag move; the line is the '
        f"trajectory, its rings are {_SIGMAS:.0f} sigma of the position, dashed lines are loops.</p>"
        "</details></section>"
    )
    scripts = f'<script type="application/json" id="scene-data">{data}</script><script>{script}</script>'
    return section, scripts


def _traces(record: RunRecord, ceiling: float | None) -> dict[str, Any]:
    path = record.scans.triple("position")
    every = max(-(-len(path) // _MAX_PATH), 1)
    low, high = extent(record.points_map, path)  # of the map's pictures: what is seen far off must not shrink the rest
    if ceiling is not None:
        high[2] = max(ceiling, float(path[:, 2].max()))
    near = np.flatnonzero(((record.points_map >= low) & (record.points_map <= high)).all(axis=1))
    points = record.points_map[near[:: -(-max(len(near), 1) // MAX_POINTS)]]
    return {
        "points": [_packed(column) for column in points.T],
        "colors": HEIGHT,
        "path": [_packed(column) for column in path[::every].T],
        "seconds": _packed(record.scans.seconds[::every]),
        "rings": [_packed(column) for column in _rings(path, record.scans.triple("sigma_position")).T],
        "loops": [_packed(column) for column in loop_lines(record).T],
    }


def _packed(values: NDArray[Any]) -> dict[str, str]:
    """Return an array as the page takes it: its type and its bytes."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()}


def _rings(path: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ellipses of the position's uncertainty in the three planes at a few poses, parted by NaN rows."""
    angle = np.append(np.linspace(0.0, 2.0 * np.pi, 25), np.nan)
    c, s, o = np.cos(angle), np.sin(angle), np.where(np.isnan(angle), np.nan, 0.0)
    unit = np.concatenate([np.stack(axes, axis=1) for axes in ((c, s, o), (c, o, s), (o, c, s))])
    chosen = np.unique(np.linspace(0, len(path) - 1, _ELLIPSES).astype(np.int64))
    return np.concatenate([path[i] + _SIGMAS * sigma[i] * unit for i in chosen])


def loop_lines(record: RunRecord) -> NDArray[np.float64]:
    """Return the loops that stand as lines between their two poses, parted by NaN rows, (3 L, 3) [m].

    Parameters
    ----------
    record : RunRecord
        Its folder may have ``loops.csv`` and the keyframes' journal; without them there are none.
    """
    table, journal = record.folder / "loops.csv", record.folder / "keyframes" / "journal.jsonl"
    if not table.is_file() or not journal.is_file():
        return np.zeros((0, 3))
    entries = [json.loads(line) for line in plain_file(journal, TABLE).read_text(encoding="utf-8").splitlines()]
    stamps = {entry["index"]: entry["stamp_ns"] for entry in entries if "stamp_ns" in entry}
    with plain_file(table, TABLE).open(encoding="utf-8", newline="") as file:
        pairs = [(int(row["query"]), int(row["match"])) for row in csv.DictReader(file) if row["verdict"] == "accepted"]
    ends, path = record.scans["end_ns"], record.scans.triple("position")
    lines = []
    for query, match in pairs:
        if query in stamps and match in stamps:
            at = np.clip(np.searchsorted(ends, [stamps[query], stamps[match]]), 0, len(ends) - 1)
            lines += [path[at[0]], path[at[1]], np.full(3, np.nan)]
    return np.array(lines).reshape(-1, 3)
