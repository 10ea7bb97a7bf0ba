"""The last lines of a run."""

from __future__ import annotations

import json as jsonlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

__all__ = ["check_lines", "closing_lines", "print_closing", "times", "warning_lines"]

LAP_SHARE = 0.05
"""Largest share of the way between start and end of a lap."""

ClosingLines: TypeAlias = Callable[[dict[str, Any], Path], list[str]]


def closing_lines(facts: Mapping[str, Any], folder: Path) -> list[str]:
    """Return what a run amounted to: distance, time, gap, speed, level, weakest direction, files, verdict.

    Parameters
    ----------
    facts : mapping
        As in ``run.json``.
    folder : Path
        Where the files lie.
    """
    timings, weakest = facts["timings"], facts["weakest"]
    # What is written after the last scan is told apart, so it is no part of a scan's time.
    later = {"writing": timings.get("closing_s", 0.0)}
    parts = ", ".join(
        f"{name} {1e3 * max(timings.get(f'{name}_s', 0.0) - later.get(name, 0.0), 0.0) / facts['scans']:.1f}"
        for name in ("reading", "odometry", "graph", "writing")
        if f"{name}_s" in timings
    )
    closing = f", then {timings['closing_s']:.1f} s for map and report" if timings.get("closing_s") else ""
    memory = "" if facts["peak_memory_mb"] is None else f"; peak memory {facts['peak_memory_mb']:.0f} MB"
    lines = [
        f"distance {facts['distance_m']:.2f} m in {facts['duration_s']:.1f} s, {facts['scans']} scans"
        + (f", start-end gap {facts['start_end_gap_m']:.3f} m" if _is_lap(facts) else ""),
        f"{timings['wall_ms_per_scan']:.1f} ms a scan ({parts}){closing}{memory}",
    ]
    if facts["level"]["sentence"]:
        lines.append(facts["level"]["sentence"])
    if weakest["eigenvalue"] is not None:
        direction = ", ".join(f"{value:+.2f}" for value in weakest["direction_map"])
        lines.append(
            f"worst weak direction: ({direction}) in the map frame at scan {weakest['scan']}, "
            f"eigenvalue {weakest['eigenvalue']:.3f} (1/3 would be even in all directions)"
        )
    if "graph" in facts:
        lines.append(_graph_line(facts["graph"]))
        lines += [facts["graph"]["gnss"]["sentence"]] if "gnss" in facts["graph"] else []
        lines += _wheel_lines(facts["graph"].get("wheels"))
    lines += unused_lines(facts)
    for span in facts.get("blind_spans", [])[:3]:
        lines.append(
            f"blind for {span['distance_m']:.0f} m at scans {span['scans'][0]} to {span['scans'][1]}: one-sigma along "
            f"it {span['sigma_before_m']:.3f} m before, {span['sigma_after_m']:.3f} m after"
        )
    lines += check_lines(facts.get("checks", []))
    lines.append(f"written to {folder}: {', '.join(facts['files'])}")
    lines.append(f"report: {folder / 'report.html'}")
    lines.append(f"status: {facts['status']}" + "".join(f"; {reason}" for reason in facts["reasons"]))
    return lines


def unused_lines(facts: Mapping[str, Any]) -> list[str]:
    """Return a line for each sensor that the recording holds and the run has made nothing of."""
    held, graph = facts.get("recording", {}).get("streams", {}), facts.get("graph", {})
    lines = []
    if held.get("gnss", {}).get("count") and "gnss" not in graph:
        lines.append(
            f"gnss: {held['gnss']['count']} fixes in the recording were not used (--no-gnss, --no-graph, or another "
            "file of fixes)"
        )
    if held.get("wheels", {}).get("count") and "wheels" not in graph:
        lines.append(f"wheels: {held['wheels']['count']} messages in the recording were not used")
    return lines


def _is_lap(facts: Mapping[str, Any]) -> bool:
    """Whether the way ends near where it began, so that the distance between the two says something."""
    return bool(facts["start_end_gap_m"] < LAP_SHARE * facts["distance_m"])


def check_lines(checks: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the verdicts of the checks: all in one line, then one line with the remedy for each that is no PASS."""
    if not checks:
        return []
    lines = ["checks: " + ", ".join(f"{check['title']} {check['verdict']}" for check in checks)]
    return lines + [
        f"  {check['verdict']} {check['title']}: {check['evidence']}"
        + (f" -> {check['remedy']}" if check["remedy"] else "")
        for check in checks
        if check["verdict"] in ("WARN", "FAIL")
    ]


def _graph_line(graph: Mapping[str, Any]) -> str:
    loops = graph["loops"]
    line = f"{graph['keyframes']} keyframes; "
    if not loops["accepted"]:
        return line + f"no loop closed ({loops['candidates']} candidates)"
    revoked = f", {loops['revoked']} taken back" if loops["revoked"] else ""
    closed = f"{loops['accepted']} loops of {loops['candidates']} candidates{revoked}"
    return f"{line}{closed}; moved by up to {graph['moved_m']:.3f} m"


def _wheel_lines(wheels: Mapping[str, Any] | None) -> list[str]:
    if wheels is None:
        return []
    if wheels["scale"] is None:
        return [f"wheels: {wheels['speeds']} speeds, none used"]
    return [
        f"wheels: {wheels['steps'] - wheels['slips']} of {wheels['steps']} steps used, {wheels['slips']} with slip; "
        f"scale {wheels['scale']:.4f}, one-sigma {wheels['scale_sigma']:.4f}"
    ]


def warning_lines(facts: Mapping[str, Any]) -> list[str]:
    """Return one line a warning, repeats counted."""
    return [
        f"{event['severity']}: {event['message']}{times(event['count'], event['message'])}"
        for event in facts["warnings"]
        if event["severity"] != "info"
    ]


def times(count: int, message: str) -> str:
    """Return how often something came, unless it came once or the message tells."""
    return "" if count == 1 or str(count) in message.split() else f" ({count} times)"


def print_closing(
    facts: dict[str, Any], folder: Path, *, json: bool, quiet: bool, lines: ClosingLines = closing_lines
) -> None:
    """Print a run's last lines: warnings to standard error, the rest, or one JSON object, to standard output.

    What the rest is, ``lines`` says; by default `closing_lines`.
    """
    warnings = warning_lines(facts)
    if json or quiet:
        for line in warnings:
            print(line, file=sys.stderr)
        if json:
            print(jsonlib.dumps(facts, allow_nan=False))
        elif facts["status"] != "ok":
            print(f"status: {facts['status']}; {'; '.join(facts['reasons'])}", file=sys.stderr)
        return
    for line in (*warnings, *lines(facts, folder)):
        print(line)
