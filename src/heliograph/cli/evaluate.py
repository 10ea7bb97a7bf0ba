"""`heliograph evaluate`: how far a trajectory is from a reference."""

from __future__ import annotations

import json as jsonlib
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage

if TYPE_CHECKING:
    from heliograph.data import Trajectory
    from heliograph.metrics import Association, Evaluation
    from heliograph.sim.map_error import MapError

__all__ = ["evaluate", "evaluation_lines", "read_trajectory"]


class Align(str, Enum):
    """Alignments."""

    se3 = "se3"
    yaw = "yaw"
    origin = "origin"
    none = "none"


def evaluate(
    estimate: Annotated[Path, typer.Argument(metavar="ESTIMATE", help="TUM or KITTI file, or a run's folder.")],
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="TUM or KITTI file, or a simulated recording.")
    ],
    align: Annotated[Align, typer.Option("--align", help="Before the absolute error is taken.")] = Align.se3,
    delta: Annotated[float, typer.Option("--delta", metavar="M", help="Path length of the relative error.")] = 10.0,
    time_offset: Annotated[
        str, typer.Option("--time-offset", metavar="S|auto", help="Added to the estimate's stamps.")
    ] = "0",
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.html", help="Both ways and the error over time, as a page.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Compare a trajectory with a reference: absolute error (ATE) and relative error (RPE).

    A run's map is compared with the surfaces of the world where the reference is a simulated recording.
    """
    from heliograph.errors import ConfigError
    from heliograph.metrics import associate
    from heliograph.metrics import evaluate as evaluate_trajectory

    try:
        offset = time_offset if time_offset == "auto" else float(time_offset)
    except ValueError:
        raise ConfigError(f"--time-offset '{time_offset}' is neither a number of seconds nor 'auto'") from None
    if not delta > 0.0:
        raise ConfigError(f"--delta {delta:g} is not a positive length in metres")
    stage("reading")
    ours, theirs = read_trajectory(estimate, "trajectory.tum"), read_trajectory(reference, "groundtruth_imu.tum")
    stage("comparing")
    result = evaluate_trajectory(ours, theirs, align=align.value, delta=delta, time_offset=offset)
    pair = associate(ours, theirs, time_offset=result.time_offset)
    if plot is not None:
        from heliograph.atomic import write_text
        from heliograph.report.pages import evaluation_page

        write_text(plot, evaluation_page(pair, result, evaluation_lines(result)))
    error, why_not = _map_error(estimate, reference, pair)
    if json:
        facts = result.as_dict()
        typer.echo(jsonlib.dumps(facts if error is None else {**facts, "map": asdict(error)}))
    else:
        typer.echo("\n".join([*evaluation_lines(result), *(why_not if error is None else [_map_line(error)])]))


def _map_error(run: Path, recording: Path, pair: Association) -> tuple[MapError | None, list[str]]:
    """Return how far a run's map is from the world of a simulated recording, where there are both, or why not."""
    path = next((path for path in (run / "map.ply", run / "map.pcd") if path.is_file()), None)
    if path is None:
        return None, []
    from heliograph.errors import HeliographError
    from heliograph.io.files.clouds import read_cloud
    from heliograph.lie import se3
    from heliograph.metrics import align_poses
    from heliograph.sim.map_error import map_error
    from heliograph.sim.write import read_simulation

    stage("measuring the map")
    try:
        simulation = read_simulation(recording)
        if simulation is None:
            return None, []
        points = read_cloud(path).points.astype("float64")
        T_world_map = align_poses(pair.T_estimate, pair.T_reference)
        return map_error(simulation.world, se3.act(T_world_map, points)), []
    except HeliographError as error:
        return None, [f"map  not compared with the world: {error}"]


def _map_line(error: MapError) -> str:
    return (
        f"map  {error.points} of its points are off the world's surfaces by {1e3 * error.median:.1f} mm (median), "
        f"{1e3 * error.p95:.1f} mm (95 %); {100.0 * error.far_share:.2f} % by more than 50 mm"
    )


def read_trajectory(path: Path, in_folder: str) -> Trajectory:
    """Read a TUM or KITTI file, told apart by the numbers in a row; of a folder, the file named ``in_folder``."""
    from heliograph.io.files.poses import read_poses

    return read_poses(path / in_folder if path.is_dir() else path)


def evaluation_lines(result: Evaluation) -> list[str]:
    """Return an evaluation in words, with units."""
    absolute, relative = result.absolute, result.relative
    lines = [
        f"{result.poses_compared} of {result.poses_reference} reference poses compared over {result.duration:.1f} s, "
        f"path {result.path_length:.2f} m, alignment {result.align}, time offset {1e3 * result.time_offset:+.1f} ms",
        f"ATE  rmse {absolute.rmse:.4f} m, median {absolute.median:.4f}, max {absolute.max:.4f}; "
        f"rotation rmse {absolute.rotation_rmse_deg:.3f} deg",
    ]
    if relative.n:
        lines.append(
            f"RPE  over {relative.delta:g} m ({relative.n} pairs): {relative.translation_rmse:.4f} m rmse "
            f"({relative.translation_rmse_percent:.2f} %), rotation {relative.rotation_rmse_deg:.3f} deg rmse"
        )
    else:
        lines.append(f"RPE  none: the path is shorter than {relative.delta:g} m; choose a smaller --delta")
    lines.append(f"start-end gap {result.start_end_gap:.4f} m, the reference's {result.start_end_gap_reference:.4f} m")
    return lines
