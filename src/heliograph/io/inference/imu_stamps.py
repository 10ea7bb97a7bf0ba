"""Stamps of an IMU that tell when its messages were handled, not when it measured: bunched, delayed, equal."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.data import ImuBatch, Message, Scan
from heliograph.io.raw import RawImu, RawMessage

__all__ = ["EvenStamps", "behind_imu", "even_period", "uneven_period"]

_BUNCHED_STEP, _BUNCHED_SHARE = 0.2, 0.25  # share of steps below this many periods, from which on stamps are bunched
_LONG_STEP = 3.0  # periods: no bunch without waiting
_MIN_SAMPLES = 100
_WINDOW = 400  # samples whose least delay stands for none
_BLOCKS = 20  # stretches whose least delayed samples make the period
_GAP_NS = 400_000_000  # beyond any delay: samples are missing


def uneven_period(samples: Sequence[RawImu]) -> int | None:
    """Return the true period [ns] where stamps are bunched or equal although samples differ; None where all is well.

    An IMU measures at even times; drivers that stamp at arrival show waiting as long steps, and what had queued up
    meanwhile as steps of nothing.
    """
    stamps = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
    values = np.array([(*sample.gyro, *sample.accel) for sample in samples])
    if len(stamps) < _MIN_SAMPLES:
        return None
    fresh = np.concatenate([[True], np.any(np.diff(values, axis=0) != 0.0, axis=1)])
    stamps = stamps[fresh]
    steps = np.diff(stamps)
    usual = steps[steps < _GAP_NS]
    if len(usual) < _MIN_SAMPLES // 2 or np.any(usual < 0):
        return None
    period = float(usual.mean())
    bunched = float(np.mean(usual < _BUNCHED_STEP * period))
    waits = float(np.mean(usual > _LONG_STEP * period))
    return round(period) if bunched > _BUNCHED_SHARE and waits > 0.0 else None


def even_period(stamps_ns: NDArray[np.int64], period_ns: int) -> float:
    """Return the period of samples whose stamps are delayed now and then [ns].

    By the least delayed of each stretch: a line through those that are not delayed at all lies below all others.
    """
    count = len(stamps_ns)
    if count < 2 * _MIN_SAMPLES:
        return float(period_ns)
    number = np.arange(count, dtype=np.float64)
    rough = (stamps_ns[-1] - stamps_ns[0]) / (count - 1)
    rest = (stamps_ns - stamps_ns[0]).astype(np.float64) - rough * number
    blocks = np.array_split(np.arange(count), min(_BLOCKS, count // (_MIN_SAMPLES // 2)))
    least = np.array([block[rest[block].argmin()] for block in blocks])
    i, j = np.triu_indices(len(least), 1)
    return float(rough + np.median((rest[least[j]] - rest[least[i]]) / (number[least[j]] - number[least[i]])))


def behind_imu(messages: Iterator[Message], *, patience_ns: int) -> Iterator[Message]:
    """Yield messages, each scan once the samples of its time have come: in a recording they only lie further on.

    Parameters
    ----------
    messages : iterator of Message
        As received.
    patience_ns : int
        How much later than a scan its samples may be received; after that it is passed on without them [ns].
    """
    waiting: list[Scan] = []
    covered_ns = 0
    for message in messages:
        if isinstance(message, Scan):
            waiting.append(message)
        else:
            yield message
        if isinstance(message, ImuBatch):
            covered_ns = int(message.stamps_ns[-1])
        now_ns = message.received_ns
        while waiting and (waiting[0].end_ns <= covered_ns or now_ns > waiting[0].received_ns + patience_ns):
            scan = waiting.pop(0)
            yield replace(scan, received_ns=max(scan.received_ns, now_ns))
    yield from waiting


class EvenStamps:
    """Gives samples even stamps: those of the least delayed among the last few hundred, counted on by the period.

    Parameters
    ----------
    period_ns : float
        From sample to sample [ns]; its error is forgotten with the window.
    """

    def __init__(self, period_ns: float) -> None:
        self.period_ns = period_ns
        self._count = 0
        self._last_raw: int | None = None
        self._last_ns = 0
        self._origins: deque[tuple[int, float]] = deque()  # (sample, stamp less its number of periods), least first

    def applied(self, message: RawMessage) -> RawMessage:
        """Return a message; of a sample with its even stamp."""
        return replace(message, stamp_ns=self.at(message.stamp_ns)) if isinstance(message, RawImu) else message

    def at(self, stamp_ns: int) -> int:
        """Return the even stamp [ns] of the next sample."""
        if self._last_raw is not None and stamp_ns - self._last_raw > _GAP_NS:
            self._origins.clear()
        self._last_raw = stamp_ns
        origin = stamp_ns - self._count * self.period_ns
        while self._origins and self._origins[-1][1] >= origin:
            self._origins.pop()
        self._origins.append((self._count, origin))
        if self._origins[0][0] <= self._count - _WINDOW:
            self._origins.popleft()
        even = round(self._origins[0][1] + self._count * self.period_ns)
        self._count += 1
        self._last_ns = max(even, self._last_ns + 1)
        return self._last_ns
