"""Sweeps that a driver publishes in parts, joined again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Message, Scan
from heliograph.io.inference.scans import valid_points
from heliograph.io.raw import RawCloud

__all__ = ["SweepJoiner", "parts_of_a_sweep"]

_SWEEP_NS = 100_000_000  # what parts are joined to
_MAX_PART_NS = 40_000_000  # of a longer message enough can be made by itself
_BIN = np.radians(4.0)
_MIN_GAIN = 2.0  # by which joined messages must see more directions than one
_MIN_POINTS = 50


def parts_of_a_sweep(clouds: Sequence[RawCloud], period_ns: int) -> int:
    """Return how many messages make a sweep of a tenth of a second; 1 where each is a whole one.

    Whole sweeps look the same way each time; parts see other directions one after the other.
    """
    if not 0 < period_ns < _MAX_PART_NS:
        return 1
    number = max(2, round(_SWEEP_NS / period_ns))
    seen = [_directions(points) for points, _ in map(valid_points, clouds) if len(points) >= _MIN_POINTS]
    if len(seen) < min(number, 4):
        return 1
    run = seen[:number]
    single = float(np.median([len(directions) for directions in run]))
    joined = len(np.unique(np.concatenate(run)))
    return number if joined >= _MIN_GAIN * single else 1


def _directions(points: NDArray[np.float32]) -> NDArray[np.int64]:
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    bins = np.floor(np.stack([azimuth, elevation], axis=1) / _BIN).astype(np.int64)
    return np.unique(bins[:, 0] * 1000 + bins[:, 1])


@dataclass(slots=True)
class SweepJoiner:
    """Joins every few scans of a stream to one; other messages pass.

    Parameters
    ----------
    period_ns : int
        From one part to the next [ns].
    """

    period_ns: int

    def joined(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Yield the messages, each whole sweep when its last part has come."""
        parts: list[Scan] = []
        for message in messages:
            if not isinstance(message, Scan):
                yield message
                continue
            if parts and message.stamp_ns - parts[0].stamp_ns > _SWEEP_NS - self.period_ns // 2:
                yield _whole(parts)
                parts = []
            parts.append(message)
        if parts:
            yield _whole(parts)


def _whole(parts: Sequence[Scan]) -> Scan:
    """Return the scan that the parts make, with the stamps of the first."""
    first, start_ns = parts[0], min(part.stamp_ns for part in parts)
    offsets = np.concatenate([part.offsets_ns + np.int32(part.stamp_ns - start_ns) for part in parts])
    intensity = [part.intensity for part in parts]
    ring = [part.ring for part in parts]
    return replace(
        first,
        stamp_ns=start_ns,
        received_ns=parts[-1].received_ns,
        end_ns=max(part.end_ns for part in parts),
        points=np.concatenate([part.points for part in parts]),
        offsets_ns=offsets,
        intensity=None if any(part is None for part in intensity) else np.concatenate(intensity),  # type: ignore[arg-type]
        ring=None if any(part is None for part in ring) else np.concatenate(ring),  # type: ignore[arg-type]
        has_point_times=True,
    )
