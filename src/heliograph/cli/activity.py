"""What a command is at, told on standard error once it takes its time: nobody has to guess whether it hangs."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from heliograph.cli.terminal import is_live, live_line, plain
from heliograph.errors import OutputError

__all__ = ["Activity", "announced", "hush", "stage"]

LIVE_SECONDS, LINE_SECONDS = 2.0, 5.0
"""When the first word comes: on a terminal, and elsewhere, where each word is a line that stays."""
_TICK = 0.25


class Activity:
    """Says what is being done, for how long, and how far it is where that is counted.

    Parameters
    ----------
    name : str
        The command.
    now : float
        When it began, on the clock that `tell` goes by [s].
    """

    def __init__(self, name: str, now: float) -> None:
        self.name = name
        self._began = self._said = self._stage_began = now
        self._what, self._done, self._total, self._hushed = "", 0, 0, False

    def stage(self, what: str, done: int, total: int, now: float) -> None:
        """Note what is being done now, and which of how many; speak again after `hush`."""
        if what != self._what:
            self._stage_began = now
        self._what, self._done, self._total = plain(what), done, total
        if self._hushed:
            self._hushed, self._began, self._said = False, now, now

    def hush(self) -> None:
        """Leave the word to somebody else until the next stage."""
        self._hushed = True
        live_line.erase()

    def text(self, now: float) -> str:
        """Return the line as it is now."""
        parts = [self._what or "at work"]
        if self._total:
            parts[0] += f" {self._done} of {self._total}"
        parts.append(f"{now - self._began:.0f} s")
        if self._total and 0 < self._done < self._total:
            left = (now - self._stage_began) / self._done * (self._total - self._done)
            parts.append(f"{left:.0f} s left")
        return f"{self.name}: {', '.join(parts)}"

    def tell(self, now: float) -> None:
        """Show the line if it is time for it; a reader who is gone, or a full disk, ends no work."""
        if self._hushed:
            return
        if is_live(sys.stderr):
            if now - self._began >= LIVE_SECONDS:
                live_line.show(self.text(now))
        elif now - self._said >= LINE_SECONDS:
            self._said = now
            with contextlib.suppress(OSError, OutputError, ValueError):
                print(self.text(now), file=sys.stderr, flush=True)


_current: list[Activity] = []


def stage(what: str, done: int = 0, total: int = 0) -> None:
    """Note what the running command does now; of no effect outside one, or under ``--quiet``.

    Parameters
    ----------
    what : str
        As in "solving" or "laying sessions on each other".
    done, total : int
        How many of how many are done, where that is counted.
    """
    if _current:
        _current[-1].stage(what, done, total, time.monotonic())


def hush() -> None:
    """Leave the word to a bar, a server or a window until the next `stage`."""
    if _current:
        _current[-1].hush()


@contextmanager
def announced(name: str, *, quiet: bool) -> Iterator[None]:
    """Tell what goes on inside the block, unless ``quiet``."""
    if quiet:
        yield
        return
    activity, ended = Activity(name, time.monotonic()), threading.Event()

    def watch() -> None:
        while not ended.wait(_TICK):
            activity.tell(time.monotonic())

    thread = threading.Thread(target=watch, name="activity", daemon=True)
    _current.append(activity)
    thread.start()
    try:
        yield
    finally:
        _current.remove(activity)
        ended.set()
        thread.join()
        live_line.erase()
