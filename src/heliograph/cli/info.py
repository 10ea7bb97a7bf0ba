"""`heliograph info`: what a recording holds, what was inferred from it, and why."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from heliograph.cli import options, terminal
from heliograph.cli.activity import stage
from heliograph.cli.closing import times

if TYPE_CHECKING:
    from rich.console import Console

    from heliograph.io.info import InfoReport, StreamInfo

__all__ = ["info", "print_table"]


def info(
    recordings: options.Recordings,
    reader: options.Reader = None,
    lidar_topic: options.LidarTopic = None,
    imu_topic: options.ImuTopic = None,
    extrinsic: options.Extrinsic = None,
    start: options.Start = None,
    duration: options.Duration = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    json: options.Json = False,
) -> None:
    """Show sensors, rates, gaps, units, time fields and frames of a recording, with the evidence for each inference."""
    from heliograph.io import open_recording
    from heliograph.io.info import inspect_recording

    resolved = options.build_config(
        config, settings, input=options.input_options(lidar_topic, imu_topic, extrinsic, start, duration, reader)
    )
    stage("reading the recording")
    with open_recording(recordings, resolved.input) as recording:
        report = inspect_recording(recording)
    if json:
        from heliograph.output.facts import plain

        typer.echo(jsonlib.dumps(plain(report.as_dict()), allow_nan=False))
    else:
        _show(report)


def _show(report: InfoReport) -> None:
    console = terminal.console()
    fields = f", fields {' '.join(report.fields)}" if report.fields else ""
    console.print(f"[bold]{_plain(report.recording)}[/]  {report.duration_s:.1f} s")
    if report.points_per_scan:
        console.print(f"{report.points_per_scan:.0f} points a scan{_plain(fields)}")
    print_table(
        console,
        ("sensor", "topic", "frame", "messages", "Hz", "seconds", "trouble"),
        [
            (s.sensor, s.topic, s.frame, str(s.count), f"{s.rate_hz:.2f}", f"{s.duration_s:.1f}", _trouble(s))
            for s in report.streams
        ],
    )
    print_table(
        console,
        ("inferred", "value", "evidence", "from"),
        [(i.name, i.value, i.evidence, i.source) for i in report.inferences],
    )
    used = {stream.topic for stream in report.streams}
    others = [(t.name, t.message_type, t.kind, str(t.count)) for t in report.topics if t.name not in used]
    if others:
        print_table(console, ("other topic", "type", "kind", "messages"), others)
    if report.frames:
        console.print(f"tf frames: {_plain(', '.join(report.frames))}")
    if report.has_orientation:
        console.print("Imu.orientation is present; no estimator uses it")
    for event in report.events:
        color = "dim" if event.severity == "info" else "yellow"
        console.print(f"[{color}]{event.severity}:[/] {_plain(event.message)}{times(event.count, event.message)}")


def _trouble(stream: StreamInfo) -> str:
    """Return what is wrong with a stream in a few words."""
    counts = {name: getattr(stream, name) for name in ("gaps", "duplicates", "rewinds", "late", "unusable")}
    words = [f"{count} {name}" for name, count in counts.items() if count]
    if counts["gaps"]:
        words[0] += f" up to {stream.longest_gap_s:.2f} s"
    return ", ".join(words) or "none"


def print_table(console: Console, head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows of plain text under a dim head."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for name in head:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(_plain(cell) for cell in row))
    console.print()
    console.print(table)


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)
