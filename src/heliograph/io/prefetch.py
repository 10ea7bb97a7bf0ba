"""Reads ahead in a thread, so that decoding overlaps estimation."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterator
from typing import TypeVar

__all__ = ["prefetch"]

T = TypeVar("T")
_POLL_S = 0.1


def prefetch(iterator: Iterator[T], depth: int = 8) -> Generator[T, None, None]:
    """Yield the items of ``iterator``, produced by a background thread at most ``depth`` ahead.

    Order is kept, an exception is raised again where it would have come, and closing the generator (or leaving its
    loop) stops the thread before it returns.

    Parameters
    ----------
    iterator : iterator
        Used by the thread alone until this generator ends.
    depth : int
        Items read ahead.
    """
    items: queue.Queue[tuple[T] | BaseException | None] = queue.Queue(maxsize=max(1, depth))
    stop = threading.Event()

    def put(item: tuple[T] | BaseException | None) -> None:
        while not stop.is_set():
            try:
                items.put(item, timeout=_POLL_S)
            except queue.Full:
                continue
            return

    def work() -> None:
        try:
            for item in iterator:
                put((item,))
                if stop.is_set():
                    return
        except BaseException as error:
            put(error)
        else:
            put(None)

    thread = threading.Thread(target=work, name="heliograph-prefetch", daemon=True)
    thread.start()
    try:
        while (item := items.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item[0]
    finally:
        stop.set()
        thread.join()
