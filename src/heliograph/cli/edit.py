"""`heliograph edit`: a plan of edits applied to a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli.activity import stage

__all__ = ["edit"]


def edit(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of merged runs.")],
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="TOML: [[remove_box]], [[add_loop]], [[forbid_loop]] ...")
    ],
) -> None:
    """Apply a plan to a run: remove boxes, add or forbid loops, drop sessions; trajectory, map and graph follow.

    A plan is always applied to what the run itself left: the same plan gives the same files, an empty one the run.
    """
    from heliograph.editing import apply_edits
    from heliograph.edits import read_edits

    stage("applying the plan and solving again")
    account, asked = apply_edits(run, plan), read_edits(plan)
    typer.echo(
        f"{len(asked.boxes)} boxes removed, {len(asked.added)} loops added, {len(asked.forbidden)} forbidden, "
        f"{len(asked.dropped)} sessions dropped: {account.accepted} loops stand; trajectory, map and graph of {run} "
        "were written anew"
    )
