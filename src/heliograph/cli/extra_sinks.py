"""What a run may hand its results to beside its folder: the viewer, and files of the scans."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from heliograph.output.sink import Sink
    from heliograph.viewer import Screen

__all__ = ["ExtraSinks", "extra_sinks"]


@dataclass
class ExtraSinks:
    """The sinks, and the viewer's screen where there is one."""

    sinks: list[Sink] = field(default_factory=list)
    screen: Screen | None = None

    def show(self, folder: Path) -> None:
        """Show the finished run behind what was shown live."""
        if self.screen is None:
            return
        from heliograph.errors import HeliographError
        from heliograph.viewer import show_run

        try:
            missing = show_run(folder, self.screen)
        except HeliographError as error:  # the run's own files are there: its account must not be lost for a picture
            missing = [str(error)]
        for line in missing:
            typer.echo(f"note: {line}", err=True)


def tell_port(screen: Screen) -> None:
    """Say which port the viewer's window took, where it was not the usual one."""
    from heliograph.viewer.screen import PORT

    if screen.port not in (None, PORT):
        typer.echo(f"port {PORT} is in use; the viewer takes {screen.port}", err=True)


def end_screen(screen: Screen) -> None:
    """Close a screen; that its window is gone is told, and ends nothing."""
    from heliograph.errors import HeliographError

    try:
        screen.close()
    except HeliographError as error:
        typer.echo(f"note: {error}", err=True)


@contextmanager
def extra_sinks(name: str, *, view: bool, rrd: Path | None, dump_scans: Path | None) -> Iterator[ExtraSinks]:
    """Yield the sinks that options ask for, opened before the work begins; close the screen behind it."""
    extra = ExtraSinks()
    if dump_scans is not None:
        from heliograph.output.scan_files import ScanFiles

        extra.sinks.append(ScanFiles(dump_scans))
    if view or rrd is not None:
        from heliograph.viewer import LiveView, Screen

        extra.screen = Screen(name, file=rrd, window=view)
        tell_port(extra.screen)
        extra.sinks.append(LiveView(extra.screen))
    try:
        yield extra
    finally:
        if extra.screen is not None:
            end_screen(extra.screen)
