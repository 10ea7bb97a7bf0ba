"""Whether the points' times run backwards: tried, where an IMU contradicts the LiDAR and nothing else explains it.

The LiDAR alone cannot tell. A sweep that is bent the wrong way fits the map that was bent so before, and the motion
within it comes out reversed, which a model of constant velocity takes for another motion. The IMU knows better.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

from heliograph.config import RunConfig
from heliograph.data import Message, Scan, SensorRepair, Source
from heliograph.errors import HeliographError
from heliograph.odometry import make_odometry
from heliograph.repair.source import RepairedSource

__all__ = ["reversed_point_times"]

_SECONDS = 9.0  # of the recording that are tried [s]
_FEWEST = 30  # scans that must find a place in a trial
_BROKEN, _SOUND = 0.3, 0.05  # shares of scans that the IMU contradicts: at least as recorded, at most mended


def reversed_point_times(source: Source, config: RunConfig, *, threads: int = 1) -> SensorRepair | None:
    """Return what turns the times of the points round where the sweeps agree with the IMU only so.

    Parameters
    ----------
    source : Source
        Repeatable; its first part is read twice.
    config : RunConfig
    threads : int
    """
    if not source.rig.known:  # a mounting that is looked for takes up what a bent sweep shows
        return None
    before = _contradicted(source, config, threads)
    if not before >= _BROKEN:
        return None
    repair = SensorRepair(code="point-times", sentence="", times_reversed=True)
    after = _contradicted(RepairedSource(source, [repair]), config, threads)
    if not after <= _SOUND:
        return None
    sentence = (
        f"the points' times run backwards, from a sweep's end to its start: as recorded the IMU contradicts "
        f"{100 * before:.0f} % of the scans, the other way round {100 * after:.0f} %; they are turned round - look at "
        "how the driver makes times out of azimuths"
    )
    return SensorRepair(code="point-times", sentence=sentence, times_reversed=True)


def _contradicted(source: Source, config: RunConfig, threads: int) -> float:
    """Return the share of the scans that found a place which the IMU contradicts; NaN where too few did."""
    odometry = make_odometry(config, source.rig, source.sensors, threads)
    places = against = 0
    try:
        with closing(source.stream()) as stream:  # type: ignore[type-var]
            for message in _first(stream):
                for result in odometry.add(message):
                    places += result.matched
                    against += any(event.code == "match-against-imu" for event in result.events)
    except HeliographError:
        return float("nan")
    return against / places if places >= _FEWEST else float("nan")


def _first(stream: Iterator[Message]) -> Iterator[Message]:
    first_ns: int | None = None
    for message in stream:
        if isinstance(message, Scan):
            first_ns = message.stamp_ns if first_ns is None else first_ns
            if (message.stamp_ns - first_ns) * 1e-9 > _SECONDS:
                return
        yield message
