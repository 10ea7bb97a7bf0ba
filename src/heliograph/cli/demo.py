"""`heliograph demo`: a simulated drive through the whole pipeline, measured against its truth."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.cli.closing import print_closing
from heliograph.cli.evaluate import evaluation_lines, read_trajectory
from heliograph.cli.run import execute
from heliograph.cli.simulate import sweep_progress

__all__ = ["demo"]


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where to put it.")] = Path(
        "heliograph_demo"
    ),
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of the simulation.")] = 1,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier demo in the folder.")] = False,
    threads: Annotated[int, typer.Option("--threads", metavar="N", min=0, help="Default: min(2, cores).")] = 0,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Simulate a short drive, map it, compare the result with the truth, and name the report."""
    from heliograph.config import RunConfig
    from heliograph.errors import OutputError
    from heliograph.metrics import evaluate
    from heliograph.sim import find_scenario
    from heliograph.sim.write import write_recording

    recording, folder = output / "recording", output / "run"
    if not overwrite and any(part.is_dir() and any(part.iterdir()) for part in (recording, folder)):
        raise OutputError(f"{output} holds a demo already; choose another with -o or add --overwrite")
    talk = not (json or quiet)
    if talk:
        typer.echo("simulating half a minute with a 64-beam LiDAR and an IMU ...")
    progress = sweep_progress("simulating") if not quiet else None
    write_recording(recording, find_scenario("demo"), seed, threads=max(threads, 1), overwrite=True, progress=progress)
    if talk:
        typer.echo(f"mapping it: heliograph run {recording} -o {folder}")
    run, interrupted = execute([recording], RunConfig(threads=threads), folder, overwrite=True, progress=not quiet)
    if interrupted:
        print_closing(run.facts, folder, json=json, quiet=quiet)
        raise typer.Exit(interrupted)
    stage("comparing with the truth")
    result = evaluate(
        read_trajectory(folder, "trajectory.tum"), read_trajectory(recording, "groundtruth_imu.tum"), align="se3"
    )
    if json:
        typer.echo(jsonlib.dumps({"run": run.facts, "evaluation": result.as_dict()}, allow_nan=False))
    else:
        print_closing(run.facts, folder, json=False, quiet=quiet)
        typer.echo("against the truth:\n  " + "\n  ".join(evaluation_lines(result)))
        typer.echo(f"open {folder / 'report.html'} in a browser")
