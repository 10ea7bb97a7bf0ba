"""`heliograph simulate`: a recording whose truth is known."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.guard.files import SETTINGS, plain_file

if TYPE_CHECKING:
    from heliograph.sim import Scenario

__all__ = ["simulate", "sweep_progress"]


def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="A name, such as warehouse, or a scenario.toml.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Default: ./<scenario>_<seed>.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Same seed, same files.")] = 1,
    layout: Annotated[str, typer.Option("--layout", metavar="NAME", help="Driver whose messages to write.")] = "ouster",
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", min=0.0, help="Only the first S seconds.")
    ] = None,
    threads: Annotated[int, typer.Option("--threads", metavar="N", min=1, help="For ray casting.")] = 1,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a recording in the output folder.")] = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Simulate a recording (recording.mcap) with its ground truth."""
    from heliograph.sim.write import write_recording

    chosen = _scenario(scenario)
    if duration is not None:
        chosen = chosen.thinned(duration=duration)
    folder = output or Path(f"{chosen.name}_{seed}")
    progress = None if quiet else sweep_progress("simulating")
    written = write_recording(
        folder, chosen, seed, layout=layout, threads=threads, overwrite=overwrite, progress=progress
    )
    facts = {
        "recording": str(written.recording),
        "groundtruth_imu": str(written.groundtruth_imu),
        "groundtruth_lidar": str(written.groundtruth_lidar),
        "scenario": str(written.scenario),
        "sweeps": written.sweeps,
        "imu_samples": written.imu_samples,
        "duration_s": written.duration,
        "seed": seed,
        "layout": layout,
    }
    if json:
        typer.echo(jsonlib.dumps(facts))
    elif not quiet:
        typer.echo(f"{written.sweeps} sweeps and {written.imu_samples} IMU samples over {written.duration:.1f} s")
        typer.echo(f"written to {folder}: {', '.join(Path(str(facts[k])).name for k in list(facts)[:4])}")


def _scenario(name: str) -> Scenario:
    from heliograph.errors import FormatError
    from heliograph.sim import find_scenario
    from heliograph.sim.scenario import from_toml

    if not name.endswith(".toml"):
        return find_scenario(name)
    try:
        return from_toml(plain_file(name, SETTINGS).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(
            name,
            f"cannot be read ({getattr(error, 'strerror', None) or error}); give a scenario's name or its TOML file",
        ) from error


def sweep_progress(label: str) -> Callable[[int, int], None]:
    """Return a function of sweeps done and in all that tells them."""

    def show(done: int, total: int) -> None:
        stage(f"{label}, sweep", done, total)

    return show
