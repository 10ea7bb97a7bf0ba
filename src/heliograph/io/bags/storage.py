"""One file of a recording: its topics and its messages in the order in which they were received."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

from heliograph.data import Event

__all__ = ["Channel", "RawBytes", "Storage", "merge_lazily", "note", "ros2_name"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """A topic of one file.

    Parameters
    ----------
    topic : str
        Its name.
    message_type : str
        In the ROS 2 spelling, ``package/msg/Name``.
    encoding : str
        ``"cdr"`` or ``"ros1"``.
    count : int
        Messages, as far as the file tells without being read through.
    """

    topic: str
    message_type: str
    encoding: str
    count: int


RawBytes = tuple[Channel, int, memoryview]
"""A message's channel, the time at which it was received [ns] and its payload."""


class Storage(Protocol):
    """One file; `messages` may be called several times, each call starts again."""

    channels: list[Channel]
    start_ns: int
    end_ns: int

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        ...

    def close(self) -> None:
        """Release the file."""
        ...


def note(events: list[Event], event: Event) -> None:
    """Add an event unless it is there already: a file is read more than once, its damage is reported once."""
    if event not in events:
        events.append(event)


def ros2_name(message_type: str) -> str:
    """Return a message type in the ROS 2 spelling: ``sensor_msgs/Imu`` is ``sensor_msgs/msg/Imu``."""
    package, _, name = message_type.rpartition("/")
    package = package.removesuffix("/msg")
    return f"{package}/msg/{name}" if package else name


def merge_lazily(sources: Iterable[tuple[int, Callable[[], Iterator[T]]]], key: Callable[[T], int]) -> Iterator[T]:
    """Merge time-ordered streams, opening each only when the merge reaches the time at which it starts.

    Plain `heapq.merge` would open all of them at once, which for the chunks of a file means decompressing all of it.

    Parameters
    ----------
    sources : iterable of (start, factory)
        A lower bound of each stream's first time, and how to open it.
    key : callable
        Time of an item.
    """
    waiting = sorted(enumerate(sources), key=lambda item: item[1][0])
    waiting.reverse()
    heap: list[tuple[int, int, T, Iterator[T]]] = []
    while waiting or heap:
        while waiting and (not heap or waiting[-1][1][0] <= heap[0][0]):
            order, (_, factory) = waiting.pop()
            stream = factory()
            for item in stream:
                heapq.heappush(heap, (key(item), order, item, stream))
                break
        if not heap:
            continue
        _, order, item, stream = heap[0]
        yield item
        for following in stream:
            heapq.heapreplace(heap, (key(following), order, following, stream))
            break
        else:
            heapq.heappop(heap)
