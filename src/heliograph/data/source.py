"""Where messages come from, as the pipeline sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from heliograph.data.event import Event
from heliograph.data.gnss import GnssFix
from heliograph.data.imu import ImuBatch
from heliograph.data.rig import Rig
from heliograph.data.scan import Scan

__all__ = ["Message", "Source"]

Message = Scan | ImuBatch | GnssFix


class Source(Protocol):
    """A recording, or a live stream: what the pipeline asks of it; `heliograph.testing.assert_source` is its law."""

    @property
    def rig(self) -> Rig:
        """How the sensors are mounted; with ``known=False`` the pipeline finds it from the motion."""
        ...

    @property
    def sensors(self) -> frozenset[str]:
        """What it holds of ``"lidar"``, ``"imu"`` and ``"gnss"``."""
        ...

    @property
    def repeatable(self) -> bool:
        """Whether `stream` may be called again and then yields the same from the start; a live stream cannot."""
        ...

    @property
    def events(self) -> Sequence[Event]:
        """Warnings so far: of opening, and of the stream read last."""
        ...

    def stream(self) -> Iterator[Message]:
        """Yield the messages in the order in which they were received; stamps of one sensor increase.

        The iterator may be dropped or closed before its end.
        """
        ...

    def close(self) -> None:
        """Release what it holds; a second call does nothing. Whoever opened the source closes it, not the pipeline."""
        ...
