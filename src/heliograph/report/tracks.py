"""What the run's other files say, as pictures: turn rates, satellite fixes, and every loop with its two clouds."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import HeliographError
from heliograph.guard.files import TABLE, plain_file
from heliograph.guard.npz import read_npz
from heliograph.io.files.poses import read_poses
from heliograph.lie import so3
from heliograph.output.record import RunRecord
from heliograph.report.png import data_uri, encode_png
from heliograph.report.svg import Line, line_chart

__all__ = ["fixes", "loop_ledger", "turn_rates"]

MAX_PICTURES = 24
"""Loops that are shown with a picture; all are in the table."""
MAX_ROWS = 200
_ROWS_SHOWN = 20  # of the ledger, without being asked
_SIDE = 220  # pixels of a picture
_MATCH, _QUERY = (110, 130, 150), (240, 160, 60)


def turn_rates(record: RunRecord) -> list[str]:
    """Return a chart of the turn rate between scans, body axes; nothing without a trajectory."""
    path = record.folder / "trajectory.tum"
    try:
        way = read_poses(path, stamped=True)
    except HeliographError:
        return []
    if len(way.stamps_ns) < 3:
        return []
    R = way.T_frame_body[:, :3, :3]
    steps = 1e-9 * np.diff(way.stamps_ns)
    rates = np.degrees(so3.log(np.swapaxes(R[:-1], 1, 2) @ R[1:])) / np.maximum(steps, 1e-9)[:, None]
    seconds = 1e-9 * (way.stamps_ns[1:] - way.stamps_ns[0])
    lines = [Line(y=np.ascontiguousarray(rates[:, i]), color=i + 1, label=axis) for i, axis in enumerate("xyz")]
    return [line_chart(seconds, lines, title="Turn rate, body axes", y_label="rate [deg/s]")]


def fixes(record: RunRecord) -> list[str]:
    """Return charts of the fixes' residuals: those used, and those left out; nothing where no fix was judged."""
    rows = _rows(record.folder / "gnss.csv")
    judged = [row for row in rows if row.get("residual_east_m")]
    if not judged:
        return []
    seconds = np.array([float(row["stamp"]) for row in judged])
    values = np.array([[float(row[f"residual_{axis}_m"]) for axis in ("east", "north", "up")] for row in judged])
    used = np.array([float(row.get("weight") or 0.0) > 0.0 for row in judged])
    charts = []
    for title, chosen in (("GNSS residuals, fixes used", used), ("GNSS residuals, fixes left out", ~used)):
        if chosen.any():
            lines = [Line(y=np.where(chosen, values[:, i], np.nan), color=i + 1, label=name)
                     for i, name in enumerate(("east", "north", "up"))]  # fmt: skip
            charts.append(line_chart(seconds - seconds[0], lines, title=title, y_label="residual [m]"))
    return charts


def loop_ledger(record: RunRecord) -> str:
    """Return the loops of the ledger, those that stand first and with a picture each; nothing where there was none."""
    rows = _rows(record.folder / "loops.csv")
    if not rows:
        return ""
    ordered = sorted(rows, key=lambda row: row["verdict"] != "accepted")
    pictures = ""
    for row in ordered[:MAX_PICTURES]:
        picture = _pair(record.folder / "keyframes", row)
        if picture:
            words = escape(f"{row['match']} and {row['query']}: {row['verdict']}")
            pictures += (
                f'<figure class="pair"><img src="{picture}" width="{_SIDE}" height="{_SIDE}" alt="Keyframes {words}">'
            )
            pictures += f"<figcaption>{words}</figcaption></figure>"
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in _cells(row)) + "</tr>"
        for row in ordered[:MAX_ROWS]
    )
    left = f'<p class="note">and {len(rows) - MAX_ROWS} more in loops.csv</p>' if len(rows) > MAX_ROWS else ""
    head = "".join(f"<th>{name}</th>" for name in ("number", "keyframes", "verdict", "reason", "overlap", "shift"))
    stand = sum(row["verdict"] == "accepted" for row in rows)
    intro = f"{stand} of {len(rows)} candidates stand. Grey: the place as it was; orange: the later scan, laid on it."
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{left}'
    if len(rows) > _ROWS_SHOWN:
        table = f"<details><summary>All candidates, one by one</summary>{table}</details>"
    return (
        f'<section id="loops"><h2>Loops</h2><p class="intro">{intro}</p><div class="pairs">{pictures}</div>{table}'
        "</section>"
    )


def _cells(row: dict[str, str]) -> Sequence[str]:
    def short(name: str, form: str) -> str:
        try:
            return form.format(float(row[name]))
        except (KeyError, ValueError, TypeError):
            return ""

    overlap = short("overlap_query", "{:.0%}")
    return (row.get("number", ""), f"{row['match']} - {row['query']}", row["verdict"], row.get("reason", ""), overlap,
            short("shift_level", "{:.3f} m"))  # fmt: skip


def _pair(store: Path, row: dict[str, str]) -> str:
    """Return the two clouds of a pair from above, the later one at the pose that was found, as an image's source."""
    try:
        match, query = (_points(store / f"{int(row[name]):06d}.npz") for name in ("match", "query"))
        T = np.array(row["T_match_query"].split(), dtype=np.float64).reshape(3, 4)
    except (OSError, KeyError, ValueError, TypeError, HeliographError):
        return ""
    laid = query @ T[:3, :3].T + T[:3, 3]
    if not len(match) or not np.isfinite(laid).all():
        return ""
    low, high = np.percentile(match[:, :2], 2.0, axis=0), np.percentile(match[:, :2], 98.0, axis=0)
    middle, half = 0.5 * (low + high), 0.55 * float((high - low).max()) + 1e-6
    image = np.full((_SIDE, _SIDE, 3), (13, 19, 28), dtype=np.uint8)
    for points, color in ((match, _MATCH), (laid, _QUERY)):
        cells = np.floor((points[:, :2] - middle + half) / (2.0 * half) * _SIDE).astype(np.int64)
        inside = ((cells >= 0) & (cells < _SIDE)).all(axis=1)
        image[_SIDE - 1 - cells[inside, 1], cells[inside, 0]] = color
    return data_uri(encode_png(image))


def _points(file: Path) -> NDArray[np.float64]:
    return np.asarray(read_npz(file)["points_imu"], dtype=np.float64)


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with plain_file(path, TABLE).open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error):
        return []
