"""What the first messages of a topic show of its recording: two sensors on it, late delivery, clocks far apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from heliograph.data import Event, ImuClock, Scan
from heliograph.errors import DataError
from heliograph.io.inference.mounting import FrameTree
from heliograph.io.inference.scans import PointTiming, to_scan
from heliograph.io.raw import RawCloud, RawImu

__all__ = ["clock_apart", "delivery_delay", "of_one_frame"]

M = TypeVar("M", RawCloud, RawImu)

_SHARE = 0.1  # of the messages from which on a second frame is a second sensor
_MAX_CLOCK_DISTANCE_S = 1.0  # beyond which no queue makes messages that arrive together be stamped apart
_DELAY_QUANTILE = 0.98


def of_one_frame(messages: Sequence[M], kind: str, linked: FrameTree, other: str) -> tuple[list[M], list[Event]]:
    """Return the messages of one frame, where a topic mixes those of several sensors, and what to say of that.

    Parameters
    ----------
    messages : sequence of RawCloud or RawImu
        The first of a topic.
    kind : str
        ``"LiDAR"`` or ``"IMU"``.
    linked : FrameTree
        The recording's frames.
    other : str
        Frame of the other sensor; a frame that is linked with it, or the same, is preferred to one with more messages.
    """
    counts = Counter(message.frame_id for message in messages)
    frames = [name for name, count in counts.most_common() if count >= _SHARE * len(messages)]
    if len(frames) < 2:
        return list(messages), []
    first = {name: k for k, name in reversed(list(enumerate(message.frame_id for message in messages)))}

    def rank(name: str) -> tuple[bool, int, int]:
        fits = bool(other) and (name == other or linked.find(name, other) is not None)
        # Two sensors of one rate differ by a message or two only: then the one that came first is taken.
        return (not fits, -round(4.0 * counts[name] / len(messages)), first[name])

    best = min(frames, key=rank)
    listing = ", ".join(f"'{name}' ({counts[name]})" for name in frames)
    text = (
        f"{messages[0].topic} mixes {len(frames)} {kind}s, frames {listing} of the first {len(messages)} messages: "
        f"only '{best}' is used; record each sensor on a topic of its own"
    )
    code = "imu-frames" if kind == "IMU" else "lidar-frames"
    return [message for message in messages if message.frame_id == best], [Event(code=code, message=text)]


def delivery_delay(samples: Sequence[RawImu]) -> int:
    """Return by how much later than the quickest messages come that a driver sends in bundles [ns]."""
    lag = np.array([sample.received_ns - sample.stamp_ns for sample in samples], dtype=np.int64)
    return int(np.quantile(lag - lag.min(), _DELAY_QUANTILE)) if len(lag) else 0


def clock_apart(clouds: Sequence[RawCloud], samples: Sequence[RawImu], timing: PointTiming) -> ImuClock | None:
    """Return the IMU's clock against the LiDAR's by the times of reception, where they are far apart; None elsewhere.

    A scan is received after its last point was measured, a sample right after it was.
    """
    if not clouds or not samples:
        return None
    scans = list(_usable_scans(clouds, timing))
    if not scans:
        return None
    lidar = float(np.median([float(scan.received_ns - scan.end_ns) for scan in scans]))
    imu = float(np.median([float(sample.received_ns - sample.stamp_ns) for sample in samples]))
    offset = (lidar - imu) * 1e-9
    if abs(offset) < _MAX_CLOCK_DISTANCE_S:
        return None
    return ImuClock(offset=offset, reference_ns=scans[0].stamp_ns)


def _usable_scans(clouds: Sequence[RawCloud], timing: PointTiming) -> Iterator[Scan]:
    """Yield the clouds that can be read; one whose times are none is told, and left out, when its turn comes."""
    for cloud in clouds:
        try:
            yield to_scan(cloud, timing)
        except DataError:
            continue
