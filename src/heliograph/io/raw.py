"""Messages as a container holds them, before anything is inferred: every reader yields these."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.boundary import outside_each

__all__ = [
    "RawCloud",
    "RawFix",
    "RawImu",
    "RawMessage",
    "RawSource",
    "RawSpeed",
    "RawTransform",
    "TopicInfo",
    "until_damage",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class RawCloud:
    """A point cloud as named columns (views into the message where possible; not yet filtered for NaN).

    ``layout`` names how it was stored (``"PointCloud2"``, ``"livox/CustomMsg"``, ``"velodyne-bin"`` ...), so that
    inference can recognise a driver. ``swapped`` tells that the points are in the other byte order than the message
    says.
    """

    topic: str
    received_ns: int
    stamp_ns: int
    frame_id: str
    columns: Mapping[str, NDArray[np.generic]]
    layout: str = "PointCloud2"
    base_time_ns: int | None = None
    swapped: bool = False

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def points(self) -> int | None:
        """How many there are; None where a coordinate is missing, for a message may have other fields than the last."""
        return self.columns["x"].size if all(axis in self.columns for axis in "xyz") else None


@dataclass(frozen=True, slots=True, kw_only=True)
class RawImu:
    """One inertial sample in the recording's own units."""

    topic: str
    received_ns: int
    stamp_ns: int
    frame_id: str
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]
    has_orientation: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFix:
    """One GNSS fix."""

    topic: str
    received_ns: int
    stamp_ns: int
    frame_id: str
    latitude_deg: float
    longitude_deg: float
    altitude: float
    covariance_enu: NDArray[np.float64] | None
    valid: bool
    solution: str = ""

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawSpeed:
    """One speed by wheels or legs: of a body in its own axes [m/s], or how fast joints turn.

    ``frame_id`` is the body's. ``v_body`` is NaN where the message has joints instead; ``joints`` are then their rates
    by name. ``sigma`` is what the message says of its own noise, one-sigma; zeros: nothing. ``position`` is the body's
    in a frame of the message's own, where it has one [m].
    """

    topic: str
    received_ns: int
    stamp_ns: int
    frame_id: str
    v_body: NDArray[np.float64]
    sigma: NDArray[np.float64]
    position: NDArray[np.float64] | None = None
    joints: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTransform:
    """One tf edge: ``p_parent = T_parent_child @ p_child``."""

    topic: str
    received_ns: int
    parent: str
    child: str
    T_parent_child: NDArray[np.float64]
    static: bool

    def __post_init__(self) -> None:
        freeze(self)


RawMessage = RawCloud | RawImu | RawFix | RawSpeed | RawTransform


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """A topic of the container.

    ``kind`` is ``"lidar"``, ``"imu"``, ``"gnss"``, ``"speed"``, ``"tf"``, ``"lidar-packets"`` or ``"other"``.
    """

    name: str
    message_type: str
    kind: str
    count: int


class RawSource(Protocol):
    """A container of raw messages; opening it must be cheap, and `messages` may be called several times."""

    description: str
    topics: tuple[TopicInfo, ...]
    events: list[Event]

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in the order in which they were received.

        Damage (a truncated file) ends the iteration and is added to ``events``; it never raises after the first
        message.
        """
        ...

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the sensor's own ``T_imu_lidar`` and its name, where the container's metadata tell it."""
        ...

    def close(self) -> None:
        """Release the files."""
        ...


def until_damage(source: RawSource, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
    """Yield a source's messages up to where a library fails in them, which is then added to the source's events."""
    try:
        yield from outside_each(source.description, messages)
    except FormatError as error:
        event = Event(code="truncated", message=f"{error}; what was read before that is used")
        if event not in source.events:
            source.events.append(event)
