"""`heliograph merge`: several runs in one map."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage

__all__ = ["merge", "merged_lines"]


def merge(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="Folders of runs, two at least.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the merged map.")],
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Link runs where they saw the same places, and make one graph and one map of them, from their folders alone.

    The first run's frame is kept. A run that nothing links for sure stays apart and is named. `heliograph loops DIR
    --revoke N` takes a link back.
    """
    from heliograph.errors import DataError
    from heliograph.merging import open_session
    from heliograph.merging.folder import merge_into

    resolved = [run.resolve() for run in runs]
    if len(set(resolved)) < len(resolved):
        raise DataError("a run is named twice; name each once")
    if output.resolve() in resolved:
        raise DataError(f"{output} is one of the runs; choose another folder with -o")
    stage("reading the runs")
    facts = merge_into(
        [open_session(run) for run in runs],
        output,
        overwrite=overwrite,
        watch=lambda done, total: stage("comparing the runs, place", done, total),
    )
    typer.echo(jsonlib.dumps(facts) if json else "\n".join(merged_lines(facts, output)))


def merged_lines(facts: dict[str, Any], folder: Path) -> list[str]:
    """Return what a merge amounted to."""
    lines = []
    for session in facts["sessions"]:
        held = f"{session['links']} links" if session["linked"] else "not linked for sure: stays apart"
        shift = f", stamps moved by {1e-9 * session['stamp_shift_ns']:.1f} s" if session["stamp_shift_ns"] else ""
        lines.append(f"{session['name']}: {session['keyframes']} keyframes, {held}{shift}")
    graph = facts["graph"]
    lines.append(
        f"{graph['keyframes']} keyframes in one map, {graph['loops']['accepted']} loops and links stand, "
        f"{facts['contradicted']} taken back"
    )
    lines.append(f"written to {folder}: {', '.join(facts['files'])}")
    lines.append(f"status: {facts['status']}" + "".join(f"; {reason}" for reason in facts["reasons"]))
    return lines
