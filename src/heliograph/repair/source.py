"""A recording as its repairs leave it, again a `Source`."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np

from heliograph.data import Event, ImuBatch, Message, Rig, Scan, SensorRepair, Source

__all__ = ["RepairedSource"]


class RepairedSource:
    """Passes a source's messages on, mended.

    Parameters
    ----------
    source : Source
    repairs : sequence of SensorRepair
        Applied in order.
    """

    def __init__(self, source: Source, repairs: Sequence[SensorRepair]) -> None:
        self.source, self.repairs = source, tuple(repairs)

    @property
    def rig(self) -> Rig:
        """The mounting of the last repair that has one, else the source's."""
        return next((repair.rig for repair in reversed(self.repairs) if repair.rig is not None), self.source.rig)

    @property
    def sensors(self) -> frozenset[str]:
        """The source's, less what cannot be mended."""
        lost = any(repair.without_imu for repair in self.repairs)
        return self.source.sensors - {"imu"} if lost else self.source.sensors

    @property
    def repeatable(self) -> bool:
        """As the source's."""
        return self.source.repeatable

    @property
    def description(self) -> str:
        """The source's name."""
        return str(getattr(self.source, "description", "the recording"))

    @property
    def events(self) -> Sequence[Event]:
        """The source's events, and one for each repair."""
        mended = [Event(code=f"repaired-{repair.code}", message=repair.sentence) for repair in self.repairs]
        return [*self.source.events, *mended]

    def stream(self) -> Iterator[Message]:
        """Yield the source's messages, mended."""
        stream = self.source.stream()
        if isinstance(stream, Generator):
            with closing(stream):
                yield from map(self.mended, stream)
        else:
            yield from map(self.mended, stream)

    def close(self) -> None:
        """Close the source."""
        self.source.close()

    def mended(self, message: Message) -> Message:
        """Return one message as the repairs leave it."""
        if isinstance(message, Scan) and any(repair.times_reversed for repair in self.repairs):
            return _the_other_way_round(message)
        if not isinstance(message, ImuBatch):
            return message
        for repair in self.repairs:
            message = replace(
                message,
                gyro=message.gyro @ repair.gyro.T,
                accel=message.accel @ repair.accel.T,
                stamps_ns=message.stamps_ns if repair.clock.exact else repair.clock.lidar_time(message.stamps_ns),
            )
        return message


def _the_other_way_round(scan: Scan) -> Scan:
    """Return a scan whose points' times run from the sweep's end to its start."""
    if not len(scan):
        return scan
    first, last = int(scan.offsets_ns.min()), int(scan.offsets_ns.max())
    return replace(scan, offsets_ns=(first + last - scan.offsets_ns.astype(np.int64)).astype(np.int32))
