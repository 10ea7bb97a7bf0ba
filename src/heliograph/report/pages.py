"""Pages beside the run's own report: an evaluation against a reference, and runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.guard.files import SETTINGS, plain_file
from heliograph.io.files.poses import read_poses
from heliograph.metrics import Association, Evaluation
from heliograph.report.charts import centre_axis, equal_grid
from heliograph.report.hover import hover_script
from heliograph.report.png import data_uri
from heliograph.report.svg import Line, line_chart, polyline

__all__ = ["comparison_page", "evaluation_page", "ways"]

MAX_MAPS = 8
"""Runs whose maps are put into the page as pictures."""


def evaluation_page(pair: Association, result: Evaluation, lines: Sequence[str]) -> str:
    """Return an evaluation as one HTML document: its numbers, both ways from above, the error over time.

    Parameters
    ----------
    pair : Association
        Estimate and reference at common stamps.
    result : Evaluation
        What was found of that pair.
    lines : sequence of str
        The evaluation in words.
    """
    aligned = result.absolute.T_reference_estimate @ pair.T_estimate
    seconds = 1e-9 * (pair.stamps_ns - pair.stamps_ns[0])
    errors = np.asarray(result.absolute.errors, dtype=np.float64)
    off = aligned[:, :3, 3] - pair.T_reference[:, :3, 3]
    axes = [Line(y=np.ascontiguousarray(1e3 * off[:, i]), color=i + 1, label=name) for i, name in enumerate("xyz")]
    words = "".join(f"<li>{escape(line)}</li>" for line in lines)
    body = (
        f'<h1>Evaluation</h1><ul class="reasons">{words}</ul><div class="one">'
        f'{ways([("reference", pair.T_reference[:, :3, 3]), ("estimate", aligned[:, :3, 3])])}</div><div class="two">'
        f"{line_chart(seconds, [Line(y=1e3 * errors)], title='Error of the position', y_label='error [mm]', floor=0.0)}"
        f"{line_chart(seconds, axes, title='The same, axes of the reference', y_label='error [mm]')}</div>"
    )
    return _document("Evaluation", body)


def comparison_page(
    names: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], folders: Sequence[Path], notes: Sequence[str]
) -> str:
    """Return runs side by side as one HTML document: a table, their ways from above, their maps.

    Parameters
    ----------
    names : sequence of str
        The runs' names.
    rows : sequence of (str, sequence of str)
        What is compared, and a cell for each run.
    folders : sequence of Path
        The runs' own; one without a trajectory or a picture of its map goes without.
    notes : sequence of str
        What else is to be said: reasons, settings that differ.
    """
    drawn = [
        (name, read_poses(path, stamped=True).T_frame_body[:, :3, 3])
        for name, folder in zip(names, folders, strict=True)
        if (path := folder / "trajectory.tum").is_file()
    ]
    head = "".join(f"<th>{escape(name)}</th>" for name in ("", *names))
    table = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in (title, *cells)) + "</tr>" for title, cells in rows
    )
    maps = "".join(
        f'<figure class="panel"><figcaption><b>{escape(name)}</b></figcaption>'
        f'<img src="{data_uri(plain_file(path).read_bytes())}" alt="Map of {escape(name)}" style="width:100%"></figure>'
        for name, folder in list(zip(names, folders, strict=True))[:MAX_MAPS]
        if (path := folder / "map.png").is_file() and path.stat().st_size <= SETTINGS
    )
    said = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return _document(
        "Runs side by side",
        f'<h1>Runs side by side</h1><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f'<tbody>{table}</tbody></table></div><ul class="reasons">{said}</ul>'
        f'<div class="one">{ways(drawn) if drawn else ""}</div>'
        f'<div class="two">{maps}</div>',
    )


def ways(named: Sequence[tuple[str, NDArray[np.float64]]]) -> str:
    """Return ways from above in one picture, x to the right and y up.

    Parameters
    ----------
    named : sequence of (str, (N, 3) float64)
        Names and positions [m].
    """
    every = np.concatenate([places for _, places in named])
    width, left, right, top, bottom = 1160, 58, 20, 16, 38
    span = np.maximum(np.ptp(every[:, :2], axis=0), 1.0) * 1.1
    scale = min((width - left - right) / span[0], 520.0 / span[1])
    height = int(max(span[1] * scale, 120.0)) + top + bottom
    x_axis = centre_axis(every[:, 0], (width - left - right) / scale, left, width - right)
    y_axis = centre_axis(every[:, 1], (height - top - bottom) / scale, height - bottom, top)
    parts = equal_grid(x_axis, y_axis, ("x [m]", "y [m]"), height, bottom, left)
    keys = ""
    for number, (name, places) in enumerate(named):
        color = number % 6 + 1
        parts.append(polyline(x_axis(places[:, 0]), y_axis(places[:, 1]), f'class="line c{color}"'))
        keys += f'<span class="key"><i class="b{color}"></i>{escape(name)}</span>'
    return (
        f'<figure class="panel wide"><figcaption><b>From above</b>{keys}</figcaption><svg class="chart" '
        f'viewBox="0 0 {width} {height}" role="img" aria-label="Ways from above">{"".join(parts)}</svg></figure>'
    )


def _document(title: str, body: str) -> str:
    style = files("heliograph.report").joinpath("style.css").read_text(encoding="utf-8")
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)} · Heliograph</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{style}</style></head>'
        f"<body><main>{body}</main>{hover_script()}</body></html>\n"
    )
