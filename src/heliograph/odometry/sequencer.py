"""Pairs each scan with the inertial samples of its time, as soon as they are there and never later than needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heliograph.config import ImuConfig
from heliograph.data import Event, GnssFix, ImuBatch, Scan
from heliograph.snapshots import PART, Stateful

__all__ = ["ImuBuffer", "Packet", "Sequencer"]

_PATIENCE_NS = round(1e9 * ImuConfig().patience)
_INTERVAL_NS = 100_000_000
_LONGEST_CUT_NS = 60_000_000_000  # a gap of the IMU that is cut into intervals


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """One scan, or None for an instant of pure dead reckoning, that is ready to be processed up to ``end_ns``."""

    scan: Scan | None
    end_ns: int


class ImuBuffer(Stateful):
    """The recent inertial samples, as one growing and forgetting array."""

    _STATE: ClassVar = {
        "_held": ImuBatch,
        "_pending": [ImuBatch],
        "last_ns": (int, None),
        "period_ns": int,
    }

    def __init__(self) -> None:
        self._held = ImuBatch.joined([])
        self._pending: list[ImuBatch] = []
        self.last_ns: int | None = None
        self.period_ns = 10_000_000

    def __len__(self) -> int:
        return len(self._held) + sum(len(batch) for batch in self._pending)

    def append(self, batch: ImuBatch) -> None:
        """Add samples that follow the ones held."""
        if len(batch) == 0:
            return
        if self.last_ns is not None:
            self.period_ns = max(1, (int(batch.stamps_ns[-1]) - self.last_ns) // len(batch))
        self._pending.append(batch)
        self.last_ns = int(batch.stamps_ns[-1])

    def _merge(self) -> None:
        if self._pending:
            self._held = ImuBatch.joined([self._held, *self._pending])
            self._pending = []

    def between(self, start_ns: int, end_ns: int) -> ImuBatch:
        """Return the samples inside the interval with one more on either side, where there is one."""
        self._merge()
        first = max(int(np.searchsorted(self._held.stamps_ns, start_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(self._held.stamps_ns, end_ns, side="left")) + 1
        return self._held[first:last]

    def until(self, end_ns: int) -> ImuBatch:
        """Return the samples held up to the first one at or after ``end_ns``."""
        self._merge()
        return self._held[: int(np.searchsorted(self._held.stamps_ns, end_ns, side="left")) + 1]

    def everything(self) -> ImuBatch:
        """Return all samples held."""
        self._merge()
        return self._held

    def forget_before(self, stamp_ns: int) -> None:
        """Drop the samples that no interval from ``stamp_ns`` on needs."""
        self._merge()
        first = max(int(np.searchsorted(self._held.stamps_ns, stamp_ns, side="right")) - 1, 0)
        self._held = self._held[first:]


class Sequencer(Stateful):
    """Orders messages into packets.

    A scan is ready once an IMU sample at or after its end has come, or messages have run one IMU period and
    ``patience_ns`` past it, or the stream has ended. Without an IMU it is ready at once; without a LiDAR packets are
    cut every ``interval_ns``.

    Parameters
    ----------
    sensors : frozenset of str
        Which of ``"lidar"`` and ``"imu"`` are used; messages of others are ignored.
    patience_ns : int
        See `ImuConfig.patience` [ns].
    interval_ns : int
        Length of packets without a LiDAR [ns].
    """

    _STATE: ClassVar = {
        "imu": PART,
        "events": [Event],
        "lead_ns": int,
        "_waiting": [Scan],
        "_last_end_ns": (int, None),
    }

    def __init__(
        self, sensors: frozenset[str], *, patience_ns: int = _PATIENCE_NS, interval_ns: int = _INTERVAL_NS
    ) -> None:
        self.imu = ImuBuffer()
        self.events: list[Event] = []
        self.lead_ns = 0
        """How far past a scan's end the IMU's stamps must have come [ns]."""
        self._sensors = sensors
        self._patience_ns, self._interval_ns = patience_ns, interval_ns
        self._waiting: list[Scan] = []
        self._last_end_ns: int | None = None

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[Packet]:
        """Take a message and return the packets that it made ready."""
        if isinstance(message, ImuBatch) and "imu" in self._sensors:
            self.imu.append(message)
            if "lidar" not in self._sensors:
                return self._cut_intervals()
        elif isinstance(message, Scan) and "lidar" in self._sensors:
            self._accept(message)
        return self._release(message.received_ns)

    def finish(self) -> list[Packet]:
        """Return the packets still waiting."""
        packets = [Packet(scan=scan, end_ns=scan.end_ns) for scan in self._waiting]
        self._waiting = []
        return packets

    def _accept(self, scan: Scan) -> None:
        if self._last_end_ns is not None and scan.end_ns <= self._last_end_ns:
            late = (self._last_end_ns - scan.end_ns) * 1e-9
            text = f"a scan ends {late:.3f} s before the previous one; it was left out, check the LiDAR's clock"
            self.events.append(Event(code="scan-rewind", message=text, stamp_ns=scan.stamp_ns))
            return
        self._last_end_ns = scan.end_ns
        self._waiting.append(scan)

    def _release(self, now_ns: int) -> list[Packet]:
        packets: list[Packet] = []
        while self._waiting and self._ready(self._waiting[0], now_ns):
            scan = self._waiting.pop(0)
            packets.append(Packet(scan=scan, end_ns=scan.end_ns))
        return packets

    def _ready(self, scan: Scan, now_ns: int) -> bool:
        if "imu" not in self._sensors:
            return True
        if self.imu.last_ns is not None and self.imu.last_ns >= scan.end_ns + self.lead_ns:
            return True
        # The recorder's clock may differ from the sensor's: patience counts from whichever is later.
        return (
            now_ns > max(scan.end_ns, scan.received_ns) + max(self.lead_ns, 0) + self.imu.period_ns + self._patience_ns
        )

    def _cut_intervals(self) -> list[Packet]:
        packets: list[Packet] = []
        last = self.imu.last_ns
        if last is None:
            return packets
        if self._last_end_ns is None:
            self._last_end_ns = int(self.imu.everything().stamps_ns[0])
        while self._last_end_ns + self._interval_ns <= last:
            self._last_end_ns = self._next_end(self._last_end_ns, last)
            packets.append(Packet(scan=None, end_ns=self._last_end_ns))
        return packets

    def _next_end(self, before_ns: int, last_ns: int) -> int:
        """Return where the next interval ends; a gap that nothing can bridge is one interval, whatever its length."""
        usual = before_ns + self._interval_ns
        if last_ns - before_ns <= _LONGEST_CUT_NS:
            return usual
        stamps = self.imu.everything().stamps_ns
        following = int(stamps[np.searchsorted(stamps, usual)])
        return following if following - before_ns > _LONGEST_CUT_NS else usual
