"""Work beside the estimation: the output map's insertions wait for memory, not for the processor."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

__all__ = ["Background"]

_MAX_WAITING = 2  # scans; each holds its points


class Background:
    """Does one job after another in a thread of its own, or at once where it has none.

    The order is kept, so that the result is the same either way. A job's failure is raised by a later call.

    Parameters
    ----------
    threaded : bool
        Whether to use a thread.
    """

    def __init__(self, *, threaded: bool) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="heliograph-map") if threaded else None
        self._waiting: deque[Future[None]] = deque()

    def do(self, job: Callable[[], None]) -> None:
        """Queue a job, then wait until no more than two are queued; a failure of one before it is raised by then."""
        if self._thread is None:
            job()
            return
        self._waiting.append(self._thread.submit(job))
        self._drain(_MAX_WAITING)

    def wait(self) -> None:
        """Return when all is done; with failures, the first one is raised once nothing is under way any more."""
        try:
            self._drain(0)
        finally:
            while self._waiting:
                self._waiting.popleft().exception()

    def close(self) -> None:
        """Finish what is queued and end the thread, whatever became of the jobs."""
        if self._thread is not None:
            self._thread.shutdown()
        self._waiting.clear()

    def _drain(self, left: int) -> None:
        while len(self._waiting) > left:
            self._waiting.popleft().result()
