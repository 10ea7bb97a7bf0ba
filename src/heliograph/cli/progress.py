"""Progress on standard error: a bar on a terminal, a line every few seconds elsewhere."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING, Any

from heliograph.cli.activity import hush, stage
from heliograph.cli.terminal import is_live, plain, raw
from heliograph.data import ScanResult
from heliograph.errors import OutputError
from heliograph.output import RunSummary, Sink
from heliograph.snapshots import Snapshot

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["ProgressSink"]

_LINE_SECONDS = 5.0
_REFRESH_SECONDS = 0.2


class ProgressSink(Sink):
    """Shows scans done, scans a second and the time left; nobody to show it to, or a full disk, ends no run.

    Parameters
    ----------
    total : int or None
        Scans expected.
    label : str
        What is being done.
    """

    def __init__(self, total: int | None, label: str) -> None:
        self.total, self.label = total, plain(label)
        self._done = self._before = 0
        self._start = self._shown = time.monotonic()
        hush()
        self._bar = _bar(total, self.label) if is_live(sys.stderr) else None

    def add(self, result: ScanResult) -> None:  # noqa: ARG002 - the protocol's; only that it came counts
        """Count one scan."""
        self._done += 1
        now = time.monotonic()
        if self._bar is not None and now - self._shown >= _REFRESH_SECONDS:
            self._shown = now
            self._draw(completed=self._done, rate=self._rate(now), refresh=True)
        elif self._bar is None and now - self._shown >= _LINE_SECONDS:
            self._shown = now
            of = f" of {self.total}" if self.total else ""
            left = f", {(self.total - self._done) / self._rate(now):.0f} s left" if self.total else ""
            with contextlib.suppress(OSError, OutputError):
                print(f"{self.label}: {self._done}{of} scans, {self._rate(now):.0f} a second{left}", file=sys.stderr)

    def snapshot(self) -> Snapshot:
        """Return how many are done."""
        return {"done": self._done}

    def restore(self, snapshot: Snapshot) -> None:
        """Go on counting from there."""
        self._done = self._before = int(snapshot["done"])

    def restart(self) -> None:
        """Count from nothing again."""
        self._done, self._before, self._start = 0, 0, time.monotonic()

    def close(self, summary: RunSummary) -> None:  # noqa: ARG002 - the protocol's
        """End the bar; what comes after the last scan is told as a stage."""
        if self._bar is not None:
            self._draw(completed=self._done, total=self._done, rate=self._rate(time.monotonic()))
            with contextlib.suppress(OSError):
                self._bar.stop()
        stage("writing what was found")

    def _draw(self, **state: Any) -> None:  # noqa: ANN401 - the bar's own
        if self._bar is not None:
            with contextlib.suppress(OSError):
                self._bar.update(self._bar.task_ids[0], **state)

    def _rate(self, now: float) -> float:
        return (self._done - self._before) / max(now - self._start, 1e-9)


def _bar(total: int | None, label: str) -> Progress:
    """Start a bar that is drawn only when told to: a refresh thread would take time from the estimation."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TextColumn("scans"),
        TextColumn("{task.fields[rate]:.0f} scans/s"), TimeRemainingColumn(),
        console=Console(file=raw(sys.stderr)), auto_refresh=False,
    )  # fmt: skip
    bar.start()
    bar.add_task(label, total=total, rate=0.0)
    return bar
