"""A recording as the estimators see it: sensors in SI units, in the order in which they came in."""

from __future__ import annotations

from array import array
from bisect import insort
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from heliograph.config import InputConfig, WheelConfig
from heliograph.data import Event, GnssFix, ImuBatch, ImuClock, ImuRecord, Message, Rig, Scan, WheelSpeeds
from heliograph.errors import CalibrationError, ConfigError, DataError, closest
from heliograph.guard.limits import ReadLimits
from heliograph.io.bags.rosbag import RosbagSource
from heliograph.io.inference.clock_steps import ClockFollower
from heliograph.io.inference.imu_stamps import EvenStamps, behind_imu, even_period
from heliograph.io.inference.imu_units import is_usable
from heliograph.io.inference.interpret import Interpretation, interpret
from heliograph.io.inference.record import Inference
from heliograph.io.inference.scans import to_scan
from heliograph.io.inference.speeds import require_speed_topic, to_speeds
from heliograph.io.inference.sweeps import SweepJoiner
from heliograph.io.raw import RawCloud, RawFix, RawImu, RawMessage, RawSource, RawSpeed, TopicInfo, until_damage
from heliograph.io.registry import open_raw_source
from heliograph.io.tally import LATE_NS, StreamTally

__all__ = ["Recording", "open_recording"]

_MAX_CLOCK_DRIFT_S = 0.02  # by which a clock found at another time may have drifted since [s]
_WATCH_EVERY = 1000  # samples
_PUNCTUAL_NS = 40_000_000  # samples that are delivered later keep their scan waiting [ns]
MAX_BATCH = 256  # samples; bounds how long an estimator waits where no scan comes


def open_recording(
    paths: Sequence[Path | str] | Path | str, config: InputConfig | None = None, *, sensors: str = "auto"
) -> Recording:
    """Open a recording and infer what its messages mean.

    Parameters
    ----------
    paths : path or sequence of paths
        A file, a folder, or several that belong together.
    config : InputConfig
        Overrides of what would be inferred, and the part to use.
    sensors : str
        ``"auto"``, ``"lidar,imu"``, ``"lidar"`` or ``"imu"``.

    Returns
    -------
    Recording
        Close it, or use it in a ``with`` statement.

    Raises
    ------
    FormatError
        A path is missing or no recording.
    TopicError, DataError
        A topic or sensor that was asked for is not there.

    Examples
    --------
    >>> with open_recording("drive.mcap") as recording:  # doctest: +SKIP
    ...     for measurement in recording.stream():
    ...         print(measurement.received_ns)
    """
    config = config or InputConfig()
    given = [paths] if isinstance(paths, str | Path) else list(paths)
    source = open_raw_source([Path(path) for path in given], reader=config.reader, limits=ReadLimits.of(config))
    try:
        return Recording(source, interpret(source, config, sensors), config)
    except BaseException:
        source.close()
        raise


class Recording:
    """An opened recording, a `Source`; see `open_recording`.

    Attributes
    ----------
    inferences : tuple of Inference
        What was concluded from the data, with the evidence.
    topics : tuple of TopicInfo
        All topics of the container.
    rig : Rig
        The LiDAR on the IMU.
    sensors : frozenset of str
        What the recording holds: ``"lidar"``, ``"imu"``, ``"gnss"``.
    repeatable : bool
        True: `stream` begins anew with each call.
    """

    repeatable = True

    def __init__(self, source: RawSource, interpretation: Interpretation, config: InputConfig) -> None:
        self._source = source
        self._config = config
        self.interpretation = interpretation
        self.tally = self._new_tally()
        self._clocks: ClockFollower | None = None
        self._even_ns: float | None = None
        self.inferences: tuple[Inference, ...] = interpretation.inferences
        self.topics: tuple[TopicInfo, ...] = source.topics
        self.rig: Rig = interpretation.mounting.rig
        antenna = self._antenna() if interpretation.gnss else None
        self.rig = replace(self.rig, antenna_imu=antenna)
        _require_recent(self.rig.clock, interpretation.start_ns)
        names = {"lidar": interpretation.lidar, "imu": interpretation.imu, "gnss": interpretation.gnss}
        self.sensors = frozenset(name for name, topic in names.items() if topic)

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the files."""
        self._source.close()

    @property
    def description(self) -> str:
        """The recording's name."""
        return self._source.description

    @property
    def events(self) -> list[Event]:
        """Warnings so far: of opening, of the files, and of the stream read last."""
        clocks = [] if self._clocks is None else self._clocks.events()
        return [*self.interpretation.events, *self._source.events, *self.tally.events(), *clocks]

    @property
    def total_scans(self) -> int | None:
        """Scans to expect from `stream`, for progress; None where the container does not tell."""
        topic = next((t for t in self.topics if t.name == self.interpretation.lidar), None)
        if topic is None or topic.kind != "lidar":
            return None
        total = topic.count
        if self._config.start > 0 or self._config.duration > 0:
            period = self.interpretation.timing.period_ns / 1e9
            total = max(0, total - round(self._config.start / period))
            if self._config.duration > 0:
                total = min(total, round(self._config.duration / period))
        return total

    def transform(self, child: str) -> NDArray[np.float64]:
        """Return ``T_imu_child`` (4, 4) for a frame of the recording, or for ``"imu"`` and ``"lidar"``.

        Raises
        ------
        CalibrationError
            No tf links the frame with the IMU or the LiDAR; the message lists the frames.
        """
        if child in ("imu", self.interpretation.imu_frame):
            return np.eye(4)
        if child in ("lidar", self.interpretation.lidar_frame):
            return self.rig.T_imu_lidar
        frames = self.interpretation.frames
        link = frames.find(self.interpretation.imu_frame, child)
        if link is not None:
            return link[0]
        link = frames.find(self.interpretation.lidar_frame, child)
        if link is not None:
            T: NDArray[np.float64] = self.rig.T_imu_lidar @ link[0]
            return T
        known = ("imu", "lidar", *frames.frames)
        raise CalibrationError(
            f"no tf links frame '{child}' with the sensors; known frames: {', '.join(known)}{closest(child, known)}"
        )

    def _antenna(self) -> NDArray[np.float64] | None:
        """Return the receiver's antenna in the imu frame (3,), where the recording's transforms tell it."""
        try:
            return np.ascontiguousarray(self.transform(self.interpretation.gnss_frame)[:3, 3])
        except CalibrationError:
            return None

    def stream(self) -> Iterator[Message]:
        """Yield scans, IMU batches and fixes in the order in which they were received.

        A batch holds the samples between two other messages, 256 at most. Messages whose stamp repeats or runs back
        are dropped and counted (see `events`); after the first message, damage ends the stream early instead of
        raising.
        """
        self.tally = self._new_tally()
        found, messages = self.interpretation, self._converted(self._followed())
        if found.parts > 1:
            messages = SweepJoiner(found.timing.period_ns).joined(messages)
        if found.imu_delay_ns > _PUNCTUAL_NS and found.lidar is not None:
            messages = behind_imu(messages, patience_ns=found.imu_delay_ns + LATE_NS)
        yield from messages

    def _followed(self) -> Iterator[RawMessage]:
        """Yield the messages of all sensors in clocks that do not jump, where they may be mended."""
        if not self._config.repair:
            self._clocks = None
            return self._messages()
        found, periods = self.interpretation, {}
        if found.lidar is not None and found.timing.stamp == "header":
            periods[found.lidar] = found.timing.period_ns
        if found.imu is not None and found.imu_stamp == "header":
            periods[found.imu] = found.imu_period_ns
        self._clocks = ClockFollower(periods)
        messages = self._clocks.followed(filter(self._is_of_the_frame, self._messages()))
        return map(EvenStamps(self._even_period()).applied, messages) if found.bunched else messages

    def _is_of_the_frame(self, message: RawMessage) -> bool:
        """Whether a message is of the sensor that was chosen where several share a topic."""
        found = self.interpretation
        if isinstance(message, RawImu) and "imu" in found.one_frame:
            return message.frame_id.lstrip("/") == found.imu_frame
        if isinstance(message, RawCloud) and "lidar" in found.one_frame:
            return message.frame_id.lstrip("/") == found.lidar_frame
        return True

    def _even_period(self) -> float:
        """Return the period of samples whose stamps are bunched, from all of them [ns]; read once."""
        if self._even_ns is None:
            stamps = [message.stamp_ns for message in self.raw_imu() if self._is_of_the_frame(message)]
            self._even_ns = even_period(np.array(stamps, dtype=np.int64), self.interpretation.imu_period_ns)
        return self._even_ns

    def _converted(self, messages: Iterator[RawMessage]) -> Iterator[Message]:
        pending: list[RawImu] = []
        passed_ns = 0
        for message in messages:
            if isinstance(message, RawImu):
                if self._accept_imu(message):
                    pending.append(message)
                elif pending and self._is_late(message, passed_ns):
                    insort(pending, message, key=lambda sample: sample.stamp_ns)
                if len(pending) >= MAX_BATCH:
                    yield self._batch(pending)
                    pending, passed_ns = [], pending[-1].stamp_ns
                continue
            converted = self._convert(message)
            if converted is None:
                continue
            if pending:
                yield self._batch(pending)
                pending, passed_ns = [], pending[-1].stamp_ns
            yield converted
        if pending:
            yield self._batch(pending)

    def _is_late(self, message: RawImu, passed_ns: int) -> bool:
        """Whether a sample that came behind a later one may still be sorted in; it is then counted as such."""
        watch = self.tally.imu
        late = self.interpretation.imu_stamp == "header" and passed_ns < message.stamp_ns and is_usable(message)
        if not (late and self._config.repair and self._imu_stamp(message) < watch.last_ns):
            return False
        watch.rewinds -= 1
        watch.unordered += 1
        return True

    def raw_imu(self) -> Iterator[RawImu]:
        """Yield the IMU's messages as they were recorded: units, order and stamps untouched, unusable ones included."""
        topic = self.interpretation.imu
        for message in self._messages(frozenset({topic} if topic else ())):
            if isinstance(message, RawImu):
                yield message

    def speeds(self, config: WheelConfig) -> WheelSpeeds:
        """Read the speeds of ``config.topic``, that topic alone, with their mounting where the transforms tell it.

        Raises
        ------
        TopicError
            There is no such topic, or it holds no speeds.
        ConfigError, DataError
            They cannot be used; see `heliograph.config.WheelConfig`.
        """
        require_speed_topic(self.topics, config.topic)
        messages = [m for m in self._messages(frozenset({config.topic})) if isinstance(m, RawSpeed)]
        try:
            frame = messages[0].frame_id if messages else ""
            T_imu_vehicle = np.ascontiguousarray(self.transform(frame)) if frame else None
        except CalibrationError:
            T_imu_vehicle = None
        return to_speeds(messages, config, T_imu_vehicle)

    def imu_record(self, watch: Callable[[str, int], None] = lambda _what, _done: None) -> ImuRecord:
        """Read the IMU once through and return all its messages as they were recorded.

        Parameters
        ----------
        watch : callable
            Called with ``"IMU samples"`` and how many were read, now and then.

        Raises
        ------
        DataError
            None came, although the recording announces some.
        """
        stamps, received, values = array("q"), array("q"), array("d")
        with closing(self.raw_imu()) as samples:  # type: ignore[type-var]
            for sample in samples:
                stamps.append(sample.stamp_ns)
                received.append(sample.received_ns)
                values.extend((*sample.gyro, *sample.accel))
                if len(stamps) % _WATCH_EVERY == 0:
                    watch("IMU samples", len(stamps))
        found, units = self.interpretation, self.interpretation.units
        if not stamps or units is None:
            raise DataError(f"{self.description}: {found.imu} holds no sample; `heliograph info` lists the topics")
        taken = {inference.name: inference.value for inference in units.inferences}
        six = np.frombuffer(values, dtype=np.float64).reshape(-1, 6)
        return ImuRecord(
            stamps_ns=np.array(stamps, dtype=np.int64),
            received_ns=np.array(received, dtype=np.int64),
            gyro=np.ascontiguousarray(six[:, :3]),
            accel=np.ascontiguousarray(six[:, 3:]),
            gyro_unit=taken.get("gyroscope unit", "rad/s"),
            accel_unit=taken.get("accelerometer unit", "m/s^2"),
            gyro_factor=units.gyro,
            accel_factor=units.accel,
            stamp=found.imu_stamp,
            topic=found.imu or "imu",
        )

    def survey(self) -> StreamTally:
        """Read the whole recording without converting it, and return the counts of its streams."""
        self.tally = self._new_tally()
        for message in self._messages():
            if isinstance(message, RawImu):
                self._accept_imu(message)
            elif isinstance(message, RawCloud):
                if self._accept_cloud(message):
                    self.tally.points += message.points or 0
                    self.tally.lidar.bad += message.points is None
            elif isinstance(message, RawFix) and self.tally.gnss.accept(message.stamp_ns, message.received_ns):
                self.tally.valid_fixes += message.valid
        return self.tally

    def summary(self) -> dict[str, object]:
        """Return the recording in plain values for ``run.json``; the counts are those of the stream read last."""
        found = self.interpretation
        rig = self.rig
        streams = {"lidar": self.tally.lidar, "imu": self.tally.imu, "gnss": self.tally.gnss}
        seen = [watch for name, watch in streams.items() if name in self.sensors and watch.count]
        first, last = min((w.first_ns for w in seen), default=0), max((w.last_ns for w in seen), default=0)
        return {
            "recording": self.description,
            "sensors": sorted(self.sensors),
            "duration_s": (last - first) / 1e9,
            "start_ns": first,
            "end_ns": last,
            "topics": {"lidar": found.lidar, "imu": found.imu, "gnss": found.gnss},
            "frames": {"lidar": found.lidar_frame, "imu": found.imu_frame, "gnss": found.gnss_frame},
            "streams": {name: watch.summary() for name, watch in streams.items() if name in self.sensors},
            "scan_period_s": found.timing.period_ns / 1e9,
            "points_per_scan": found.points_per_scan,
            "has_orientation": found.has_orientation,
            "T_imu_lidar": rig.T_imu_lidar.tolist(),
            "mounting": {"source": rig.source, "known": rig.known},
            "imu_clock": {
                "offset_s": rig.clock.offset,
                "drift_ppm": 1e6 * rig.clock.drift,
                "reference_ns": rig.clock.reference_ns,
            },
            "inferences": [
                {"name": i.name, "value": i.value, "evidence": i.evidence, "source": i.source} for i in self.inferences
            ],
        }

    def _new_tally(self) -> StreamTally:
        return StreamTally.expecting(self.interpretation.timing.period_ns, self.interpretation.imu_period_ns)

    def _messages(self, topics: frozenset[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of ``topics``, by default of all sensors, within the part of the recording to use."""
        found = self.interpretation
        if topics is None:
            topics = frozenset(topic for topic in (found.lidar, found.imu, found.gnss) if topic)
        start_ns = found.start_ns + round(self._config.start * 1e9)
        end_ns = start_ns + round(self._config.duration * 1e9) if self._config.duration > 0 else None
        if isinstance(self._source, RosbagSource):  # can skip to the start without decoding
            messages = self._source.messages(topics, start_ns if self._config.start > 0 else 0)
        else:
            messages = self._source.messages(topics)
        for message in until_damage(self._source, messages):
            if self._config.start > 0 and message.received_ns < start_ns:
                continue
            if end_ns is not None and message.received_ns > end_ns:
                return
            yield message

    def _accept_imu(self, message: RawImu) -> bool:
        if not is_usable(message):
            self.tally.imu.bad += 1
            return False
        return self.tally.imu.accept(self._imu_stamp(message), message.received_ns)

    def _imu_stamp(self, message: RawImu) -> int:
        """Return the sample's time in the LiDAR's clock, which is the recording's."""
        stamp_ns = message.stamp_ns if self.interpretation.imu_stamp == "header" else message.received_ns
        clock = self.rig.clock
        return stamp_ns if clock.exact else int(clock.lidar_time(np.int64(stamp_ns)))

    def _accept_cloud(self, message: RawCloud) -> bool:
        stamp_ns = message.stamp_ns if self.interpretation.timing.stamp == "header" else message.received_ns
        return self.tally.lidar.accept(stamp_ns, message.received_ns)

    def _convert(self, message: RawMessage) -> Message | None:
        if isinstance(message, RawCloud):
            return self._scan(message)
        if isinstance(message, RawFix) and self.tally.gnss.accept(message.stamp_ns, message.received_ns):
            return GnssFix(
                stamp_ns=message.stamp_ns,
                received_ns=message.received_ns,
                latitude_deg=message.latitude_deg,
                longitude_deg=message.longitude_deg,
                altitude=message.altitude,
                covariance_enu=message.covariance_enu,
                valid=message.valid,
                frame_id=message.frame_id,
                solution=message.solution,
            )
        return None

    def _scan(self, message: RawCloud) -> Scan | None:
        if not self._accept_cloud(message):
            return None
        try:
            scan = to_scan(message, self.interpretation.timing)
        except DataError:
            self.tally.lidar.bad += 1
            return None
        if len(scan) == 0:
            self.tally.lidar.empty += 1
        self.tally.points += len(scan)
        return replace(scan, frame_id=self.interpretation.lidar_frame or "lidar")

    def _batch(self, samples: list[RawImu]) -> ImuBatch:
        units = self.interpretation.units
        if units is None:
            raise DataError(
                "an IMU sample came from a recording without IMU topic"
            )  # cannot happen: topics are filtered
        return ImuBatch(
            stamps_ns=np.array([self._imu_stamp(s) for s in samples], dtype=np.int64),
            gyro=np.array([s.gyro for s in samples], dtype=np.float64) * units.gyro,
            accel=np.array([s.accel for s in samples], dtype=np.float64) * units.accel,
            received_ns=samples[-1].received_ns,
            frame_id=samples[-1].frame_id or "imu",
        )


def _require_recent(clock: ImuClock, start_ns: int) -> None:
    """Refuse a clock's drift carried on from too long ago: by now the offset may be anything."""
    away = (start_ns - clock.reference_ns) * 1e-9
    if abs(clock.drift * away) > _MAX_CLOCK_DRIFT_S:
        raise ConfigError(
            f"the clock of the extrinsic file was found {abs(away) / 3600.0:.1f} h from this recording, in which its "
            f"drift of {1e6 * clock.drift:.1f} ppm adds up to {clock.drift * away:+.3f} s: calibrate this recording, "
            "or set drift_ppm = 0 to keep the offset alone"
        )
