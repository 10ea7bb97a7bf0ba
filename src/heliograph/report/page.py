"""The report's page: what came out, how far to trust it, and why, in that order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.atomic import atomic_path, write_text
from heliograph.checks import VERDICT_WORDS, Finding
from heliograph.data import Event
from heliograph.output.record import RunRecord
from heliograph.output.summary import RunSummary
from heliograph.report import charts
from heliograph.report.hover import hover_script
from heliograph.report.lettering import lettered, world_file
from heliograph.report.mapview import MapPictures
from heliograph.report.meanings import anchor, find_meaning, meanings_section
from heliograph.report.png import encode_png
from heliograph.report.scene import scene
from heliograph.report.statement import accuracy, files_beside, streams
from heliograph.report.tracks import fixes, loop_ledger, turn_rates

__all__ = ["write_report"]

_MANY_COLUMNS = 3
_LAP_SHARE, _LAP_GAP = 0.05, 10.0  # of the way, and [m]: the gap between start and end of a lap at most
_FACTS = {
    "recording": ("recording", ""), "duration_s": ("it lasts", "s"), "scan_period_s": ("a sweep takes", "s"),
    "points_per_scan": ("points a sweep", ""),
}  # fmt: skip
_STATUS_WORDS = {
    "ok": "the result holds together",
    "degraded": "usable with care",
    "lost": "not to be trusted",
}


def write_report(record: RunRecord) -> list[Path]:
    """Write ``report.html`` and, where there is a map, ``map.png`` with its world file; return their paths.

    Parameters
    ----------
    record : RunRecord
        A finished run with at least one scan.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    paths, pictures = [], None
    if len(record.points_map):
        pictures = MapPictures(record)
        paths += [record.folder / "map.png", record.folder / "map.pgw"]
        with atomic_path(paths[-2]) as temporary:
            temporary.write_bytes(encode_png(lettered(pictures.image(pictures.top_raster, "height"), pictures.top)))
        write_text(paths[-1], world_file(pictures.top))
    paths.append(record.folder / "report.html")
    write_text(paths[-1], page(record, pictures))
    return paths


def page(record: RunRecord, pictures: MapPictures | None) -> str:
    """Return the report as one HTML document without references to anything outside it."""
    name = escape(record.name)
    style = files("heliograph.report").joinpath("style.css").read_text(encoding="utf-8")
    turned, scripts = scene(record, None if pictures is None else pictures.ceiling)
    body = "".join(
        (
            header(record),
            pictures.html() if pictures is not None else "",
            turned,
            section("Trajectory", [charts.trajectory(record, turned_like(pictures))], wide=True),
            section("", [*charts.motion(record.scans), *turn_rates(record)]),
            observability(record),
            section("Uncertainty", [*charts.uncertainty(record.scans), *charts.biases(record.scans)]),
            section("Satellite fixes", gnss_charts) if (gnss_charts := fixes(record)) else "",
            loop_ledger(record),
            section("Time", [charts.timings(record), timing_table(record)]),
            inferences(record.facts.get("inferences", [])),
            meanings_section(event.code for event in record.summary.events),
            tables(record),
        )
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name} · Heliograph</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{style}</style></head>'
        f"<body><main>{body}</main>{hover_script()}{scripts}</body></html>\n"
    )


def turned_like(pictures: MapPictures | None) -> bool:
    """Return whether the map's picture has x up, so that the trajectory below it is drawn alike."""
    return pictures is not None and pictures.top.labels[0] != "x"


def header(record: RunRecord) -> str:
    """Return title, verdict, the numbers that matter, and the warnings."""
    summary = record.summary
    facts = [
        ("distance", f"{summary.distance:.1f}", "m"),
        ("duration", f"{summary.duration:.1f}", "s"),
        ("scans", f"{summary.scans}", ""),
        # A drive from here to there has no gap to speak of; a lap has.
        *([("start-end gap", f"{summary.start_end_gap:.3f}", "m")] if _is_lap(summary) else []),
        *([("level known to", f"{np.degrees(summary.level.sigma):.2g}", "deg")] if summary.level.known else []),
        ("a scan", f"{summary.ms_per_scan:.1f}", "ms"),
        ("sensors", " + ".join({"lidar": "LiDAR", "imu": "IMU"}[name] for name in summary.sensors), ""),
    ]
    tiles = "".join(f"<div><dt>{name}</dt><dd>{value}<small> {unit}</small></dd></div>" for name, value, unit in facts)
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in summary.reasons)
    version = escape(str(record.facts.get("versions", {}).get("heliograph", "")))
    return (
        f'<header><p class="brand">Heliograph {version} · run report</p><h1>{escape(record.name)}</h1>'
        f'<p class="verdict {summary.status}"><b>{summary.status}</b> {_STATUS_WORDS[summary.status]}</p>'
        f'{f"<ul class=reasons>{reasons}</ul>" if reasons else ""}<dl class="tiles">{tiles}</dl>'
        f"{accuracy(record)}{checks(record)}"
        f"{warnings(record)}</header>"
    )


def _is_lap(summary: RunSummary) -> bool:
    return summary.start_end_gap < min(_LAP_SHARE * summary.distance, _LAP_GAP)


def checks(record: RunRecord) -> str:
    """Return the six verdicts, each with what was measured, and what to do where it is no PASS."""
    rows = "".join(
        f'<li class="{finding.verdict}"><b>{VERDICT_WORDS[finding.verdict]}</b> {_picture(finding)}: '
        f"{escape(finding.evidence)}{f' <i>{escape(finding.remedy)}</i>' if finding.remedy else ''}</li>"
        for finding in record.summary.findings
    )
    return f'<ul class="checks">{rows}</ul>' if rows else ""


def _picture(finding: Finding) -> str:
    """Return a finding's title, as a link to where the run shows it if it does."""
    target = finding.picture.removeprefix("report.html")
    return f'<a href="{escape(target)}">{escape(finding.title)}</a>' if target else escape(finding.title)


def warnings(record: RunRecord) -> str:
    """Return the warnings as callouts; remarks are left to the tables."""
    rows = "".join(
        f'<li class="{escape(event.severity)}">{remark(event)}</li>'
        for event in record.summary.events
        if event.severity != "info"
    )
    return f'<ul class="warnings">{rows}</ul>' if rows else ""


def remark(event: Event) -> str:
    """Return an event's code, how often it came, and what it says."""
    code = escape(event.code)
    named = f'<a href="#{anchor(event.code)}">{code}</a>' if find_meaning(event.code) else code
    return f"<b>{named}</b>{times(event.count)} {escape(event.message)}"


def times(count: int) -> str:
    """Return how often, where it was more than once."""
    return f' <span class="times">{count}×</span>' if count > 1 else ""


def section(title: str, figures: Iterable[str], *, wide: bool = False, intro: str = "") -> str:
    """Return a section of figures, two abreast or one."""
    heading = f"<h2>{title}</h2>" if title else ""
    lead = f'<p class="intro">{intro}</p>' if intro else ""
    name = f' id="{title.lower().replace(" ", "-")}"' if title else ""
    return f'<section{name}>{heading}{lead}<div class="{"one" if wide else "two"}">{"".join(figures)}</div></section>'


def observability(record: RunRecord) -> str:
    """Return how well the scans fixed the pose."""
    if "lidar" not in record.summary.sensors:
        return ""
    summary = record.summary
    intro = (
        "Eigenvalues of the information that a scan's matches give, scaled to one measurement: how well each direction "
        "is seen. Those of translation add up to 1, so 0.33 is even and 0.01 is a corridor."
    )
    if summary.weakest_index >= 0:
        direction = ", ".join(f"{value:+.2f}" for value in summary.weakest_direction)
        intro += (
            f" The weakest was {summary.weakest_eigenvalue:.3f} along ({direction}) in scan {summary.weakest_index}."
        )
    intro += "".join(f" {str(span)[0].upper()}{str(span)[1:]}." for span in summary.blind_spans[:5])
    marked = {kind: word for kind, word in charts.VERDICT_WORDS.items() if summary.statuses.get(kind)}
    keys = "".join(f'<span class="key"><i class="v-{kind}"></i>{word}</span>' for kind, word in marked.items())
    figures = [*charts.eigenvalues(record.scans), *charts.matching(record.scans)]
    return section("What the scans could see", figures, intro=intro + keys)


def timing_table(record: RunRecord) -> str:
    """Return where the wall time went."""
    summary = record.summary
    rows = [
        (name, f"{seconds:.2f} s", f"{1e3 * seconds / summary.scans:.2f} ms")
        for name, seconds in summary.seconds.items()
    ]
    rows.append(("wall", f"{summary.wall_seconds:.2f} s", f"{summary.ms_per_scan:.2f} ms"))
    note = "up to the last scan; reading is the waiting only where a second thread decodes ahead"
    return (
        '<figure class="panel"><figcaption><b>Wall time</b></figcaption>'
        f'{table(("part", "total", "a scan"), rows)}<p class="note">{note}</p></figure>'
    )


def inferences(items: Sequence[Mapping[str, Any]]) -> str:
    """Return what was inferred from the recording, with the evidence."""
    if not items:
        return ""
    columns = [key for key in items[0] if any(item.get(key) not in (None, "") for item in items)]
    rows = [tuple(str(item.get(column, "")) for column in columns) for item in items]
    return f'<section id="sensors"><h2>What was inferred from the recording</h2>{table(tuple(columns), rows)}</section>'


def tables(record: RunRecord) -> str:
    """Return the run's facts, all of its events, and its configuration."""
    summary = record.summary
    verdicts = ", ".join(f"{count} {name}" for name, count in summary.statuses.items())
    facts: list[tuple[str, ...]] = [("scans by verdict", verdicts)]
    if summary.level.known:
        facts.append(("level", summary.level.sentence()))
    recording = record.facts.get("recording", {})
    facts += [
        (words, f"{_short(recording[key])} {unit}".rstrip())
        for key, (words, unit) in _FACTS.items()
        if recording.get(key) not in (None, "")
    ]
    facts.append(("versions", ", ".join(f"{key} {value}" for key, value in record.facts.get("versions", {}).items())))
    sensors = streams(recording)
    held = table(("sensor", "topic", "frame", "messages", "rate", "wrong with them"), sensors) if sensors else ""
    remarks = [event for event in summary.events if event.severity == "info"]
    notes = "".join(f"<li>{remark(event)}</li>" for event in remarks)
    return (
        f"<section><h2>The run</h2>{held}{table(('what', 'value'), facts)}{files_beside(record)}"
        f"{f'<ul class=notes>{notes}</ul>' if notes else ''}"
        f"<details><summary>Configuration (config.toml)</summary><pre>{escape(record.config)}</pre></details></section>"
    )


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table of escaped text; one of many columns has them below each other on a phone, with their names."""
    names = [escape(cell.replace("_", " ")) for cell in head]
    many = len(names) > _MANY_COLUMNS
    top = "".join(f"<th>{name}</th>" for name in names)
    named = [f' data-name="{name}"' if many else "" for name in names]
    body = "".join(
        "<tr>" + "".join(f"<td{name}>{escape(cell)}</td>" for name, cell in zip(named, row, strict=True)) + "</tr>"
        for row in rows
    )
    box = "scroll many" if many else "scroll"
    return f'<div class="{box}"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _short(value: object) -> str:
    """Return a fact on one line."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {_short(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple, np.ndarray)):
        return ", ".join(_short(item) for item in value)
    return str(value)
