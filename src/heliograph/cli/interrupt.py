"""Ctrl-C as a request that the pipeline honours between two messages."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["interruptible"]


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C was pressed; a second Ctrl-C raises `KeyboardInterrupt` at once.

    Where the process ignores Ctrl-C it stays ignored. An exception out of the middle of an update would leave sinks
    that disagree about the last scan.
    """
    asked = threading.Event()

    def note(_number: int, _frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()
        print("\ninterrupted: saving what is done; press Ctrl-C again to stop at once", file=sys.stderr)

    # Only the main thread may set handlers; and where Ctrl-C is ignored from the start, as behind `nohup` or in a
    # shell's background, it is meant for somebody else.
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield asked.is_set
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)
