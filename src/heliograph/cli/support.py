"""`heliograph support`: what a bug report needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["support"]


def support(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, whether it has ended or not.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.zip", help="Default: ./<run>_support.zip.")
    ] = None,
) -> None:
    """Pack a run's account, settings and tables for a bug report: no points, no positions, no paths, no names."""
    from heliograph.errors import OutputError
    from heliograph.support import pack_support

    target = output or Path(f"{run.resolve().name}_support.zip")
    if target.exists():
        raise OutputError(f"{target} exists already; remove it or choose another file with -o")
    names = pack_support(run, target)
    typer.echo(f"{target}: {', '.join(names)}; look into it before you send it")
