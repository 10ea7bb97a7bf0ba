"""Ctrl-C, and the signals that end a process, as a request that the pipeline honours between two messages."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["EndedError", "Request", "ends_in_order", "interruptible"]

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_CTRL_C = 130


class EndedError(BaseException):
    """The process is to end: what is open is released on the way out.

    It is no `KeyboardInterrupt`: typer takes that for Ctrl-C whatever it is, and the signal's exit code would be lost.

    Parameters
    ----------
    number : int
        The signal's.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


class Request:
    """Whether an end was asked for, and by which signal; calling it tells the first."""

    def __init__(self) -> None:
        self._asked = threading.Event()
        self.code = _CTRL_C
        """Exit code for whoever sent it."""

    def __call__(self) -> bool:
        """Return whether an end was asked for."""
        return self._asked.is_set()

    def note(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the second one raises at once."""
        if self._asked.is_set():
            raise EndedError(number)
        self._asked.set()
        self.code = 128 + number
        again = (
            "press Ctrl-C again to stop at once" if number == signal.SIGINT else f"{signal.Signals(number).name} came"
        )
        try:
            print(f"\ninterrupted: saving what is done; {again}", file=sys.stderr)
        except OSError:  # after SIGHUP there may be nobody to tell
            return


@contextmanager
def interruptible() -> Iterator[Request]:
    """Yield a function that tells whether Ctrl-C was pressed; a second one raises `EndedError` at once.

    SIGTERM and SIGHUP ask for the same: a batch system and a closed terminal want what is done to be kept as much as a
    user does. A signal that the process ignores stays ignored. An exception out of the middle of an update would leave
    sinks that disagree about the last scan.
    """
    request = Request()
    with _handled(request.note):
        yield request


@contextmanager
def ends_in_order() -> Iterator[None]:
    """Have SIGTERM and SIGHUP raise inside the block, so that temporary files are removed on the way out."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise EndedError(number)

    with _handled(end, leave=(signal.SIGINT,)):
        yield


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], leave: tuple[int, ...] = ()) -> Iterator[None]:
    # Only the main thread may set handlers; and where a signal is ignored from the start, as behind `nohup` or in a
    # shell's background, it is meant for somebody else.
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            if number not in leave and signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
