"""`heliograph survey`: a run in a coordinate system, tied to control points, with an account of its accuracy."""

from __future__ import annotations

import json as jsonlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage

if TYPE_CHECKING:
    from heliograph.survey import PlacedRun
    from heliograph.survey.control import ControlResidual

__all__ = ["check_coordinate_system", "deliver_run", "survey", "write_survey"]

Crs = Annotated[
    str,
    typer.Option("--crs", metavar="NAME", help="local, utm, or what pyproj reads, such as EPSG:25832."),
]


def survey(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    crs: Crs = "utm",
    points: Annotated[
        Path | None,
        typer.Option(
            "--points", metavar="FILE", help="Control points, a CSV: id, coordinates, place in the run, role."
        ),
    ] = None,
    tape: Annotated[
        list[str] | None,
        typer.Option(
            "--tape", metavar="A,B,M[,SIGMA]", help="Distance between two points of the table [m]; repeatable."
        ),
    ] = None,
    tile: Annotated[
        float,
        typer.Option("--tile", metavar="M", help="Cut the map into tiles of this edge [m], with an index.", min=0.0),
    ] = 0.0,
    e57: Annotated[bool, typer.Option("--e57", help="Write E57 too: a cloud a keyframe, with its pose.")] = False,
    json: options.Json = False,
) -> None:
    """Deliver a run in a coordinate system: LAZ, trajectory as CSV, GPX, KML and SBET, accuracy; by control points."""
    from heliograph.errors import ConfigError
    from heliograph.survey import open_placed_run

    stage("reading the run")
    placed, control = open_placed_run(run), None
    if tape and points is None:
        raise ConfigError("--tape names points of a table; give --points too")
    if points is not None:
        stage("tying the run to the points")
        placed, rows = _tied(placed, crs, points, tape or [])
        control = _facts(rows)
        if not json:
            typer.echo("\n".join(_table(rows)))
        for line in _suspects(rows):
            typer.echo(line, err=True)
    files = write_survey(placed, crs, control, tile=tile, e57=e57)
    if json:
        typer.echo(jsonlib.dumps({"files": [str(path) for path in files], "control_points": control}))
    else:
        typer.echo(f"written to {run}: {', '.join(path.name for path in files)}")


def check_coordinate_system(crs: str) -> None:
    """Raise what is wrong with a coordinate system before hours of work go by."""
    import numpy as np

    from heliograph.survey import find_coordinate_system

    find_coordinate_system(crs, np.zeros(3))


def deliver_run(folder: Path, crs: str) -> None:
    """Write the survey's files of a run that has just ended; a run that cannot be placed has a warning instead."""
    from heliograph.errors import DataError, FormatError
    from heliograph.survey import open_placed_run

    try:
        files = write_survey(open_placed_run(folder), crs)
    except (DataError, FormatError) as error:
        typer.echo(f"warning: {error}", err=True)
    else:
        typer.echo(f"in {crs}: {', '.join(path.name for path in files)}", err=True)


def write_survey(
    placed: PlacedRun, crs: str, control: dict[str, Any] | None = None, *, tile: float = 0.0, e57: bool = False
) -> list[Path]:
    """Write the survey's files into the run's folder and return them."""
    from heliograph.survey import deliver

    stage(f"writing the map in {crs}")
    return deliver(placed, crs, control, tile=tile, e57=e57)


def _tied(placed: PlacedRun, crs: str, path: Path, tapes: Sequence[str]) -> tuple[PlacedRun, list[ControlResidual]]:
    import numpy as np

    from heliograph.errors import ConfigError
    from heliograph.survey import find_coordinate_system
    from heliograph.survey.control import read_control_points, tied

    points = read_control_points(path, placed)
    if placed.origin_deg is None:
        known = [point.p_system for point in points if point.known]
        if crs in ("utm", "local"):
            raise ConfigError(
                f"--crs {crs} does not say what the control points are in: give their own, such as EPSG:25832"
            )
        anywhere = find_coordinate_system(crs, np.zeros(3))
        origin = anywhere.to_geodetic_deg(np.mean(known, axis=0)[None])[0] if known else np.zeros(3)
        system = find_coordinate_system(crs, origin)
    else:
        system = find_coordinate_system(crs, placed.origin_deg)
    return tied(placed, points, [_tape(text) for text in tapes], system)


def _tape(text: str) -> Any:  # noqa: ANN401 - a TapeLength, imported late
    from heliograph.errors import ConfigError
    from heliograph.survey.control import TapeLength

    parts = text.split(",")
    try:
        length, *sigma = [float(part) for part in parts[2:]]
        if len(sigma) > 1 or not all(0.0 < value < math.inf for value in (length, *sigma)):
            raise ValueError("no length")
        return TapeLength(
            a=parts[0].strip(), b=parts[1].strip(), length=length, **({"sigma": sigma[0]} if sigma else {})
        )
    except (ValueError, IndexError) as error:
        raise ConfigError(
            f"--tape {text}: give two points and metres, such as A,B,12.345 or A,B,12.345,0.003"
        ) from error


def _facts(rows: Sequence[ControlResidual]) -> dict[str, Any]:
    import numpy as np

    def rms(kind: str, which: str) -> list[float] | None:
        values = np.array([getattr(row, which) for row in rows if row.kind == kind])
        return np.sqrt((values**2).mean(axis=0)).tolist() if len(values) else None

    return {
        "points": [
            {"id": row.name, "kind": row.kind, "before_enu_m": row.before.tolist(), "after_enu_m": row.after.tolist(),
             "sigma_m": row.sigma, "chance": row.chance, "suspect": row.suspect}
            for row in rows
        ],
        "control_rms_enu_m": rms("control", "after"),
        "check_rms_enu_m": rms("check", "after"),
        "check_rms_before_enu_m": rms("check", "before"),
    }  # fmt: skip


def _table(rows: Sequence[ControlResidual]) -> list[str]:
    lines = [f"{'point':<12} {'role':<8} {'before: east north up [m]':<28} {'after: east north up [m]':<28} sigma"]
    for row in rows:
        if row.kind == "tape":
            before, after = f"{row.before[0]:+.3f}", f"{row.after[0]:+.3f}"
        else:
            before, after = (" ".join(f"{value:+8.3f}" for value in values) for values in (row.before, row.after))
        mark = " ?" if row.suspect else ""
        lines.append(f"{row.name:<12} {row.kind:<8} {before:<28} {after:<28} {row.sigma:.3f}{mark}")
    return lines


def _suspects(rows: Sequence[ControlResidual]) -> list[str]:
    """Return a line for the point that fits worst, where some fit worse than their sigmas allow."""
    suspects = sorted((row for row in rows if row.suspect), key=lambda row: row.chance)
    if not suspects:
        return []
    worst, others = suspects[0], len(suspects) - 1
    off = float(sum(value**2 for value in worst.after) ** 0.5)
    more = f", and {others} more" if others else ""
    return [
        f"warning: {worst.kind} {worst.name} is {off:.3f} m off where its sigma is {worst.sigma:.3f} m{more}: look at "
        "its coordinates and at where it was picked, then leave it out or make it a check point"
    ]
