"""A recording in one record, for `heliograph info`."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from heliograph.data import Event
from heliograph.io.inference.record import Inference
from heliograph.io.raw import TopicInfo
from heliograph.io.recording import Recording
from heliograph.io.tally import Watch

__all__ = ["InfoReport", "StreamInfo", "inspect_recording"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamInfo:
    """One sensor's stream.

    Parameters
    ----------
    sensor, topic, frame : str
        Which one.
    count : int
        Usable messages.
    rate_hz, duration_s : float
        Over all of it.
    gaps : int
        Steps well over the period.
    longest_gap_s : float
        The longest of them; 0 without any.
    duplicates, rewinds, late, unusable : int
        Messages with that trouble.
    """

    sensor: str
    topic: str
    frame: str
    count: int
    rate_hz: float
    duration_s: float
    gaps: int
    longest_gap_s: float
    duplicates: int
    rewinds: int
    late: int
    unusable: int


@dataclass(frozen=True, slots=True, kw_only=True)
class InfoReport:
    """What a recording holds and means.

    Parameters
    ----------
    recording : str
        Its name.
    duration_s : float
        From the first to the last stamp of its sensors.
    topics : tuple of TopicInfo
        All of the container.
    streams : tuple of StreamInfo
        The sensors that a run would use.
    inferences : tuple of Inference
        Units, time fields, mounting ..., each with evidence.
    events : tuple of Event
        Warnings.
    fields : tuple of str
        Fields of the point cloud.
    points_per_scan : float
        Mean as stored.
    frames : tuple of str
        That tf knows.
    has_orientation : bool
        The IMU messages carry one; no estimator uses it.
    valid_fixes : int
        GNSS messages that report a fix.
    """

    recording: str
    duration_s: float
    topics: tuple[TopicInfo, ...]
    streams: tuple[StreamInfo, ...]
    inferences: tuple[Inference, ...]
    events: tuple[Event, ...]
    fields: tuple[str, ...]
    points_per_scan: float
    frames: tuple[str, ...]
    has_orientation: bool
    valid_fixes: int

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def inspect_recording(recording: Recording) -> InfoReport:
    """Read a recording through and report on it.

    Parameters
    ----------
    recording : Recording
        Open; its tally is replaced.
    """
    tally = recording.survey()
    found = recording.interpretation
    chosen = (
        (found.lidar, found.lidar_frame, tally.lidar),
        (found.imu, found.imu_frame, tally.imu),
        (found.gnss, found.gnss_frame, tally.gnss),
    )
    streams = tuple(_stream(topic, frame, watch) for topic, frame, watch in chosen if topic)
    seen = [watch for topic, _, watch in chosen if topic and watch.count]
    first, last = min((w.first_ns for w in seen), default=0), max((w.last_ns for w in seen), default=0)
    return InfoReport(
        recording=recording.description,
        duration_s=(last - first) / 1e9,
        topics=recording.topics,
        streams=streams,
        inferences=recording.inferences,
        events=tuple(recording.events),
        fields=found.fields,
        points_per_scan=tally.points / tally.lidar.count if tally.lidar.count else 0.0,
        frames=found.frames.frames,
        has_orientation=found.has_orientation,
        valid_fixes=tally.valid_fixes,
    )


def _stream(topic: str, frame: str, watch: Watch) -> StreamInfo:
    return StreamInfo(
        sensor=watch.name,
        topic=topic,
        frame=frame,
        count=watch.count,
        rate_hz=watch.rate,
        duration_s=(watch.last_ns - watch.first_ns) / 1e9,
        gaps=len(watch.gaps),
        longest_gap_s=max((length for _, length in watch.gaps), default=0) / 1e9,
        duplicates=watch.duplicates,
        rewinds=watch.rewinds,
        late=watch.late,
        unusable=watch.bad,
    )
