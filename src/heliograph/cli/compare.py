"""`heliograph compare`: runs side by side."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.cli.evaluate import Align

if TYPE_CHECKING:
    from heliograph.comparison import RunComparison, RunLine

__all__ = ["compare"]


def compare(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN...", help="Folders of runs; the first is the reference.")
    ],
    align: Annotated[
        Align, typer.Option("--align", help="Of the trajectories, before their distance is taken.")
    ] = Align.se3,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="As a page too: table, ways from above, maps.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Put runs side by side: verdicts, distance between them, gaps, loops, maps, time, and settings that differ."""
    from heliograph.comparison import compare_runs
    from heliograph.output.facts import plain

    stage("comparing the runs")
    found = compare_runs(runs, align=align.value)
    if html is not None:
        from heliograph.atomic import write_text
        from heliograph.report.pages import comparison_page

        names, rows, notes = _parts(found)
        write_text(html, comparison_page(names, rows, [run.folder for run in found.runs], notes))
    typer.echo(jsonlib.dumps(plain(found.as_dict())) if json else "\n".join(_table(found)))


def _parts(found: RunComparison) -> tuple[list[str], list[tuple[str, list[str]]], list[str]]:
    """Return the runs' names, the rows of the table, and what is to be said beside it."""
    names = [f"{number}. {run.folder.resolve().name}" for number, run in enumerate(found.runs, 1)]
    rows = [(title, [cell(run) for run in found.runs]) for title, cell in _ROWS]
    rows = [(title, cells) for title, cells in rows if any(cell != "-" for cell in cells)]
    notes = [f"{name}: {reason}" for name, run in zip(names, found.runs, strict=True) for reason in _reasons(run)]
    notes += [f"{name}: not the recording of the first run" for name, run in zip(names, found.runs, strict=True)
              if run.same_recording is False]  # fmt: skip
    notes += [f"{key}: {', '.join(map(_shown, row))}" for key, row in found.settings.items()]
    return names, rows, [*notes, *([] if found.settings else ["the settings are the same"])]


def _table(found: RunComparison) -> list[str]:
    names, rows, notes = _parts(found)
    widths = [max(len(name), *(len(cells[k]) for _, cells in rows)) for k, name in enumerate(names)]
    first = max(len(title) for title, _ in rows)
    lines = ["  ".join([" " * first, *(name.ljust(width) for name, width in zip(names, widths, strict=True))]).rstrip()]
    for title, cells in rows:
        filled = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        lines.append("  ".join([title.ljust(first), *filled]).rstrip())
    return [*lines, *notes]


def _reasons(run: RunLine) -> list[str]:
    return [str(reason) for reason in run.facts.get("reasons", [])]


def _shown(value: Any) -> str:  # noqa: ANN401 - any setting
    return f"'{value}'" if isinstance(value, str) else "not there" if value is None else str(value)


def _fact(*path: str, form: str = "{}") -> Callable[[RunLine], str]:
    def cell(run: RunLine) -> str:
        value: Any = run.facts
        for name in path:
            value = value.get(name) if isinstance(value, dict) else None
        return "-" if value is None else form.format(value)

    return cell


def _own(name: str, form: str) -> Callable[[RunLine], str]:
    def cell(run: RunLine) -> str:
        value = getattr(run, name)
        return "-" if value is None else form.format(value)

    return cell


def _map_cell(run: RunLine) -> str:
    m = run.map
    return "-" if m is None else f"{m.median:.3f} / {m.p95:.3f} m, {m.far_share:.1%}"


_ROWS: tuple[tuple[str, Callable[[RunLine], str]], ...] = (
    ("status", _fact("status")),
    ("ATE to the first", _own("ate", "{:.4f} m")),
    ("  largest", _own("ate_max", "{:.4f} m")),
    ("  rotation", _own("ate_rotation_deg", "{:.3f} deg")),
    ("map median / 95 %, over 1 m", _map_cell),
    ("start-end gap", _fact("start_end_gap_m", form="{:.4f} m")),
    ("distance", _fact("distance_m", form="{:.2f} m")),
    ("duration", _fact("duration_s", form="{:.1f} s")),
    ("scans", _fact("scans")),
    ("map points", _fact("map_points")),
    ("keyframes", _fact("graph", "keyframes")),
    ("loops accepted", _fact("graph", "loops", "accepted")),
    ("wall a scan", _fact("timings", "wall_ms_per_scan", form="{:.1f} ms")),
    ("peak memory", _fact("peak_memory_mb", form="{:.0f} MB")),
    ("version", _fact("versions", "heliograph")),
)
