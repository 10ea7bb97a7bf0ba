"""`heliograph view`: a run in Rerun's viewer, or in a file to share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli.activity import stage
from heliograph.cli.extra_sinks import end_screen, tell_port

__all__ = ["view"]


def view(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="The folder that `run` wrote.")],
    rrd: Annotated[
        Path | None, typer.Option("--rrd", metavar="FILE", help="Write a file to share in place of a window.")
    ] = None,
    scans: Annotated[
        Path | None, typer.Option("--scans", metavar="DIR", help="Show every scan that `run --dump-scans DIR` wrote.")
    ] = None,
    no_residuals: Annotated[
        bool, typer.Option("--no-residuals", help="Colour no cloud by its distance to the map: quicker.")
    ] = False,
) -> None:
    """Show a run in Rerun: map, way, covariance, keyframes by residual, curves over time, loops, graph, Bayes tree."""
    from heliograph.guard.account import read_account
    from heliograph.viewer import Screen, show_run

    stage("showing the run")
    read_account(folder)  # what is no run is told before a window opens
    screen = Screen(folder.resolve().name, file=rrd, window=rrd is None)
    tell_port(screen)
    try:
        missing = show_run(folder, screen, residuals=not no_residuals, scans=scans)
    except BaseException:
        end_screen(screen)
        raise
    stage("handing over to the viewer")
    screen.close()
    for line in missing:
        typer.echo(f"note: {line}", err=True)
    if rrd is not None:
        typer.echo(f"written: {rrd} ({rrd.stat().st_size / 1e6:.1f} MB); open it with `rerun {rrd}`")
