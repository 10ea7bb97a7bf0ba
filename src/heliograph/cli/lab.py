"""`heliograph lab`: the lesson's experiments in the browser."""

from __future__ import annotations

import webbrowser
from typing import Annotated

import typer

from heliograph.cli.activity import hush

__all__ = ["lab"]


def lab(
    experiment: Annotated[
        str, typer.Argument(metavar="[EXPERIMENT]", help="sensors, deskew, icp, graph, families, loop or tunnel.")
    ] = "",
    port: Annotated[int, typer.Option("--port", metavar="N", help="Taken if free, else the next one that is.")] = 8173,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
) -> None:
    """Open the lesson's experiments in the browser, driven by the engine; nothing leaves this machine."""
    from heliograph.lab import find_experiment
    from heliograph.lab.server import HOST, Laboratory, create_app, free_socket, serve

    if experiment:
        find_experiment(experiment)
    laboratory = Laboratory()
    app = create_app(laboratory)
    listening = free_socket(port)
    taken = listening.getsockname()[1]
    if port and taken != port:
        typer.echo(f"port {port} is in use; taking {taken}")
    address = f"http://{HOST}:{taken}/" + (f"#{experiment}" if experiment else "")
    typer.echo(f"lab: {address} (Ctrl-C ends it)")
    if not no_browser and not _opened(address):
        typer.echo("no browser opened by itself; open that address in one")
    hush()
    try:
        serve(app, listening)
    finally:
        laboratory.close()


def _opened(address: str) -> bool:
    try:
        return webbrowser.open(address)
    except (webbrowser.Error, OSError):
        return False
