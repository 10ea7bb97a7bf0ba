"""`heliograph check`: what is wrong with a recording, how badly, and what to do about it."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options, terminal
from heliograph.cli.activity import stage

if TYPE_CHECKING:
    from rich.console import Console

    from heliograph.checks import CheckReport, Finding, Number
    from heliograph.config import RunConfig
    from heliograph.io import Recording

__all__ = ["check"]

_COLORS = {"ok": "green", "unknown": "dim", "warn": "yellow", "fail": "bold red"}


def check(
    recordings: options.Recordings,
    imu: Annotated[bool, typer.Option("--imu", help="The checks of the IMU; so far these are all there are.")] = False,  # noqa: ARG001 - the contract's; other groups of checks will come beside it
    lidar_topic: options.LidarTopic = None,
    imu_topic: options.ImuTopic = None,
    extrinsic: options.Extrinsic = None,
    start: options.Start = None,
    duration: options.Duration = None,
    threads: options.Threads = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Check a recording's IMU, each fault with a remedy; of a run's folder, read its six verdicts."""
    from heliograph.examination import examine_imu
    from heliograph.pipeline import thread_count

    if len(recordings) == 1 and (recordings[0] / "run.json").is_file():
        _show_run(recordings[0], json=json, quiet=quiet)
        return
    resolved = options.build_config(
        config,
        settings,
        run={"threads": threads},
        input=options.input_options(lidar_topic, imu_topic, extrinsic, start, duration),
    )
    stage("opening the recording")
    opened, why = _open(recordings, resolved)
    with opened as recording:
        report = examine_imu(recording, resolved, threads=thread_count(resolved), why=why, watch=_watch)
    if json:
        from heliograph.output.facts import plain

        typer.echo(jsonlib.dumps(plain(report.as_dict()), allow_nan=False))
    else:
        _show(report, quiet=quiet)


def _open(paths: list[Path], config: RunConfig) -> tuple[Recording, str]:
    """Open a recording, without its LiDAR where that is missing or unusable; return why with it."""
    from heliograph.errors import DataError
    from heliograph.io import open_recording

    for path in paths:
        if (path / "run.json").is_file():
            raise DataError(f"{path} is the folder of a run: give it alone to read its verdicts, or give recordings")
    try:
        return open_recording(paths, config.input), ""
    except DataError as error:
        try:
            return open_recording(paths, config.input, sensors="imu"), f"the LiDAR cannot be used: {error}"
        except DataError:
            raise error from None


def _show_run(folder: Path, *, json: bool, quiet: bool) -> None:
    """Print the verdicts that a run came to, and its status."""
    from heliograph.cli.closing import check_lines
    from heliograph.errors import DataError, FormatError
    from heliograph.guard.account import read_account

    try:
        facts = read_account(folder)
        checks, status, reasons = facts["checks"], facts["status"], facts["reasons"]
    except (FormatError, KeyError):
        raise DataError(
            f"{folder} holds no verdicts: its run has not ended, or was made before runs gave any; run it again"
        ) from None
    if json:
        typer.echo(jsonlib.dumps({"status": status, "reasons": reasons, "checks": checks}, allow_nan=False))
        return
    if not quiet:
        for check in checks:
            remedy = f"\n    -> {check['remedy']}" if check["remedy"] else ""
            typer.echo(f"{check['verdict']:<11} {check['title']}: {check['evidence']}{remedy}")
    else:
        typer.echo("\n".join(check_lines(checks)))
    typer.echo(f"status: {status}" + "".join(f"; {reason}" for reason in reasons))


def _watch(what: str, done: int) -> None:
    """Tell how many messages of a kind have been looked at."""
    stage(f"checking, {done} {what}")


def _show(report: CheckReport, *, quiet: bool) -> None:
    from rich.markup import escape

    console = terminal.console()
    if not quiet:
        _head(console, report)
        _table(console, report.findings)
    for event in _list(report.facts.get("events")):
        console.print(f"[yellow]{event['severity']}:[/] {escape(event['message'])}", soft_wrap=True)
    console.print(_closing(report), soft_wrap=True)  # a sentence is a line, however wide the terminal


def _head(console: Console, report: CheckReport) -> None:
    from rich.markup import escape

    facts = report.facts
    console.print(
        f"[bold]{escape(report.recording)}[/]  {facts['samples']} IMU samples, {facts['scans']} scans compared over "
        f"{facts['lidar_seconds']:.1f} s"
    )
    for item in _list(facts.get("inferences")):
        console.print(f"[dim]{escape(item['name'])}: {escape(item['value'])} ({escape(item['evidence'])})[/]")


def _table(console: Console, findings: tuple[Finding, ...]) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for name in ("check", "verdict", "measured", "limit", "evidence, and what to do"):
        table.add_column(name, overflow="fold", no_wrap=name in ("verdict", "measured", "limit"))
    for finding in findings:
        color = _COLORS[finding.verdict]
        text = escape(finding.evidence) + (f"\n[{color}]-> {escape(finding.remedy)}[/]" if finding.remedy else "")
        decided = finding.numbers[0] if finding.numbers else None
        table.add_row(escape(finding.title), f"[{color}]{finding.verdict}[/]", *_value_text(decided), text)
    console.print()
    console.print(table)
    console.print()


def _value_text(number: Number | None) -> tuple[str, str]:
    """Return value and limit in words."""
    if number is None or number.value is None:
        return "", ""
    unit = f" {number.unit}" if number.unit else ""
    return f"{number.value:.3g}{unit}", "" if number.limit is None else f"{number.limit:.3g}{unit}"


def _closing(report: CheckReport) -> str:
    """Return the last line: the verdict, and the remedy of what matters most."""
    from rich.markup import escape

    from heliograph.checks import worst

    first = worst(report.findings)
    color = _COLORS[report.verdict]
    if first is None or report.verdict in ("ok", "unknown"):
        untold = sum(finding.verdict == "unknown" for finding in report.findings)
        rest = f"; {untold} of {len(report.findings)} checks could not tell" if untold else ""
        mend = ", nothing to mend" if report.verdict == "ok" else ""
        return f"verdict: [{color}]{report.verdict}[/]{mend}{rest}"
    others = sum(finding.verdict in ("warn", "fail") for finding in report.findings) - 1
    more = f" ({others} more above)" if others else ""
    return (
        f"verdict: [{color}]{report.verdict}[/], {escape(first.title)}: {escape(first.evidence)}\n"
        f"first: {escape(first.remedy)}{more}"
    )


def _list(value: object) -> list[dict[str, Any]]:
    return list(value) if isinstance(value, list) else []
