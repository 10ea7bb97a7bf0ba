"""What a recording holds and means, concluded from its first messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from heliograph.config import InputConfig
from heliograph.data import Event, ImuClock
from heliograph.errors import DataError, TopicError, closest
from heliograph.io.inference.imu_stamps import uneven_period
from heliograph.io.inference.imu_units import ImuUnits, infer_imu_units
from heliograph.io.inference.mixed import clock_apart, delivery_delay, of_one_frame
from heliograph.io.inference.mounting import FrameTree, Mounting, find_mounting
from heliograph.io.inference.record import Inference, make_inference
from heliograph.io.inference.scans import PointTiming
from heliograph.io.inference.sweeps import parts_of_a_sweep
from heliograph.io.inference.timing import infer_timing
from heliograph.io.raw import RawCloud, RawFix, RawImu, RawMessage, RawSource, RawTransform, TopicInfo, until_damage

__all__ = ["Interpretation", "interpret"]

PROBE_CLOUDS, PROBE_SAMPLES, MIN_SAMPLES = 12, 400, 20
FULL_PROBE_NS = 3_000_000_000
DEFAULT_IMU_PERIOD_NS = 5_000_000
Note = Inference | Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Interpretation:
    """The chosen topics, how to convert their messages, and why.

    Parameters
    ----------
    lidar, imu, gnss : str or None
        Chosen topics.
    timing : PointTiming
        For `scans.to_scan`.
    units : ImuUnits
        Factors to SI.
    mounting : Mounting
        LiDAR on IMU.
    frames : FrameTree
        All frames.
    lidar_frame, imu_frame, gnss_frame : str
        As the messages name them.
    imu_stamp : str
        ``"header"``, or ``"received"`` where the samples carry no usable stamp.
    imu_period_ns : int
        From sample to sample [ns].
    has_orientation : bool
        The IMU messages carry an orientation (no estimator uses it).
    start_ns : int
        When the first message was received [ns].
    points_per_scan : int
        Points of the first scans, as stored.
    fields : tuple of str
        Fields of the cloud.
    inferences, events : tuple
        Conclusions and warnings.
    one_frame : frozenset of str
        The ones of ``"lidar"`` and ``"imu"`` whose topic mixes several sensors: messages of other frames are left out.
    parts : int
        Messages that make one sweep.
    bunched : bool
        Whether the samples' stamps tell when they were handled; see `imu_stamps`.
    imu_delay_ns : int
        How much later than the quickest samples are delivered [ns].
    """

    lidar: str | None
    imu: str | None
    gnss: str | None
    timing: PointTiming
    units: ImuUnits | None
    mounting: Mounting
    frames: FrameTree
    lidar_frame: str
    imu_frame: str
    gnss_frame: str
    imu_stamp: str
    imu_period_ns: int
    has_orientation: bool
    start_ns: int
    points_per_scan: int
    fields: tuple[str, ...]
    inferences: tuple[Inference, ...]
    events: tuple[Event, ...]
    one_frame: frozenset[str] = frozenset()
    parts: int = 1
    bunched: bool = False
    imu_delay_ns: int = 0


@dataclass(slots=True)
class _Probe:
    """The first messages of every topic that may matter."""

    clouds: dict[str, list[RawCloud]] = field(default_factory=dict)
    samples: dict[str, list[RawImu]] = field(default_factory=dict)
    fixes: dict[str, list[RawFix]] = field(default_factory=dict)
    transforms: list[RawTransform] = field(default_factory=list)
    start_ns: int | None = None

    def add(self, message: RawMessage) -> None:
        if isinstance(message, RawTransform):
            self.transforms.append(message)
            return
        self.start_ns = message.received_ns if self.start_ns is None else min(self.start_ns, message.received_ns)
        if isinstance(message, RawCloud):
            found = self.clouds.setdefault(message.topic, [])
            if len(found) < PROBE_CLOUDS:
                found.append(message)
        elif isinstance(message, RawImu):
            samples = self.samples.setdefault(message.topic, [])
            if len(samples) < PROBE_SAMPLES:
                samples.append(message)
        elif isinstance(message, RawFix):
            self.fixes.setdefault(message.topic, []).append(message)


def interpret(source: RawSource, config: InputConfig, sensors: str = "auto") -> Interpretation:
    """Choose topics and infer what their messages mean.

    Parameters
    ----------
    source : RawSource
        The opened recording.
    config : InputConfig
        Overrides.
    sensors : str
        ``"auto"`` or a comma-separated choice of ``lidar`` and ``imu``.

    Raises
    ------
    TopicError
        A topic given by name does not exist.
    DataError
        The recording lacks a sensor that was asked for, or its messages cannot be used.
    """
    wants_lidar, wants_imu = (sensors == "auto" or name in sensors.split(",") for name in ("lidar", "imu"))
    lidars = _candidates(source.topics, "lidar", config.lidar_topic if wants_lidar else "", wants_lidar)
    imus = _candidates(source.topics, "imu", config.imu_topic if wants_imu else "", wants_imu)
    _require(source, lidars, imus, sensors)
    probe = _probe(source, lidars, imus, config.max_probe)
    lidar, lidar_why = _choose_lidar(lidars, probe, config.lidar_topic)
    imu, imu_why = _choose_imu(imus, probe, config.imu_topic)
    gnss = max(probe.fixes, key=lambda name: len(probe.fixes[name]), default=None)
    clouds, samples = probe.clouds.get(lidar or "", []), probe.samples.get(imu or "", [])
    _require_messages(source, lidar, imu, clouds, samples, sensors)
    frames = FrameTree(probe.transforms)
    lidar_frame = clouds[0].frame_id if clouds else ""
    samples, mixed_imu = of_one_frame(samples, "IMU", frames, lidar_frame) if config.repair else (samples, [])
    imu_frame = samples[0].frame_id if samples else ""
    clouds, mixed_lidar = of_one_frame(clouds, "LiDAR", frames, imu_frame) if config.repair else (clouds, [])
    timing, lidar_notes = _read_lidar(clouds, config)
    units, imu_period_ns, imu_stamp, imu_notes = _read_imu(samples, config)
    notes = [*lidar_why, *imu_why, *lidar_notes, *imu_notes, *mixed_imu, *mixed_lidar]
    mounting = find_mounting(clouds, samples, frames, source.factory_T_imu_lidar(), config.extrinsic)
    if timing.stamp == imu_stamp == "header" and mounting.rig.clock.exact:
        apart = clock_apart(clouds, samples, timing)
        notes += _clock_mismatch(apart, mended=config.repair)
        if apart is not None and config.repair:
            mounting = replace(mounting, rig=replace(mounting.rig, clock=apart))
    bunched = uneven_period(samples) if config.repair and imu_stamp == "header" else None
    if bunched is not None:
        notes.append(_bunched(samples, bunched))
        imu_period_ns = bunched
    parts = parts_of_a_sweep(clouds, timing.period_ns) if config.repair and clouds else 1
    if parts > 1:
        notes.append(_in_parts(clouds[0].topic, parts, timing.period_ns))
    return Interpretation(
        lidar=lidar if clouds else None,
        imu=imu if samples else None,
        gnss=gnss,
        timing=timing,
        units=units,
        mounting=mounting,
        frames=frames,
        lidar_frame=clouds[0].frame_id.lstrip("/") if clouds else "",
        imu_frame=samples[0].frame_id.lstrip("/") if samples else "",
        gnss_frame=probe.fixes[gnss][0].frame_id.lstrip("/") if gnss else "",
        imu_stamp=imu_stamp,
        imu_period_ns=imu_period_ns,
        has_orientation=any(sample.has_orientation for sample in samples),
        start_ns=probe.start_ns or 0,
        points_per_scan=int(np.median([c.points for c in clouds if c.points is not None] or [0])),
        fields=tuple(clouds[0].columns) if clouds else (),
        inferences=(*(note for note in notes if isinstance(note, Inference)), *mounting.inferences),
        events=(*(note for note in notes if isinstance(note, Event)), *mounting.events),
        one_frame=frozenset((*(["imu"] if mixed_imu else []), *(["lidar"] if mixed_lidar else []))),
        parts=parts,
        bunched=bunched is not None,
        imu_delay_ns=delivery_delay(samples) if config.repair else 0,
    )


def _bunched(samples: Sequence[RawImu], period_ns: int) -> Event:
    message = (
        f"{samples[0].topic}: stamps come in bunches although an IMU measures evenly: they tell when messages were "
        f"handled; the samples are spaced evenly again, {period_ns / 1e6:.2f} ms apart, behind the least delayed - "
        "stamp with the sensor's own counter"
    )
    return Event(code="imu-bunched", message=message)


def _in_parts(topic: str, parts: int, period_ns: int) -> Event:
    message = (
        f"{topic}: each message is a part of a sweep ({period_ns / 1e6:.1f} ms, other directions each time); {parts} "
        "at a time are joined, with the stamp of the first"
    )
    return Event(code="sweep-parts", message=message, severity="info")


def _candidates(topics: Sequence[TopicInfo], kind: str, wanted: str, used: bool) -> list[TopicInfo]:
    """Return the topics of a kind, or the one the user named."""
    if not used:
        return []
    found = [topic for topic in topics if topic.kind == kind]
    if kind == "lidar" and not any(topic.count for topic in found):
        found = [topic for topic in topics if topic.kind == "lidar-packets"] or found
    if not wanted:
        return [topic for topic in found if topic.count > 0] or found
    packets = [topic for topic in topics if topic.kind == "lidar-packets"] if kind == "lidar" else []
    valid = {topic.name: topic for topic in [*found, *packets]}
    if wanted not in valid:
        names = ", ".join(sorted(valid)) or "none"
        raise TopicError(
            f"--{kind}-topic {wanted}: no such {kind} topic; the valid ones: {names}{closest(wanted, valid)}"
        )
    return [valid[wanted]]


def _require(source: RawSource, lidars: list[TopicInfo], imus: list[TopicInfo], sensors: str) -> None:
    listing = ", ".join(f"{t.name} ({t.message_type})" for t in source.topics)
    among = f" among {listing}" if listing else ", nor any other"
    # Where a part could not be read, that is what the user has to know first.
    damage = next((f" ({e.message})" for e in source.events if e.code in ("damaged-chunk", "truncated")), "")
    if not lidars and sensors != "imu":
        remedy = "use --sensors imu to dead-reckon" if imus else "record a sensor_msgs/PointCloud2 or a Livox CustomMsg"
        raise DataError(f"{source.description}: no LiDAR topic{among}{damage}; {remedy}")
    if not imus and sensors != "auto" and "imu" in sensors:
        remedy = "use --sensors lidar" if sensors != "imu" else "record a sensor_msgs/Imu"
        raise DataError(f"{source.description}: no IMU topic{among}{damage}; {remedy}")


def _require_messages(
    source: RawSource, lidar: str | None, imu: str | None, clouds: list[RawCloud], samples: list[RawImu], sensors: str
) -> None:
    if lidar and not clouds:
        why = next(
            (event.message for event in source.events if event.code in ("bad-message", "truncated")),
            "the topic is empty",
        )
        raise DataError(f"{source.description}: {lidar} holds no usable scan ({why})")
    if imu and not samples and sensors != "auto" and "imu" in sensors:
        raise DataError(f"{source.description}: {imu} holds no usable sample")


def _probe(source: RawSource, lidars: list[TopicInfo], imus: list[TopicInfo], max_probe: float) -> _Probe:
    """Read the first messages; static transforms are read wherever they are, a recorder may be started late."""
    probe = _Probe()
    static = frozenset(t.name for t in source.topics if t.kind == "tf" and "static" in t.name)
    for message in until_damage(source, source.messages(static)) if static else ():
        probe.add(message)
    names = {t.name for t in [*lidars, *imus]} | {t.name for t in source.topics if t.kind in ("tf", "gnss")} - static
    for message in until_damage(source, source.messages(frozenset(names))):
        probe.add(message)
        if _is_complete(probe, lidars, imus, message.received_ns, max_probe):
            break
    return probe


def _is_complete(probe: _Probe, lidars: list[TopicInfo], imus: list[TopicInfo], now_ns: int, max_probe: float) -> bool:
    if probe.start_ns is not None and now_ns - probe.start_ns > round(1e9 * max_probe):
        return True
    elapsed = now_ns - (probe.start_ns or now_ns)
    clouds = all(
        len(probe.clouds.get(t.name, ())) >= (PROBE_CLOUDS if t.kind == "lidar-packets" else min(PROBE_CLOUDS, t.count))
        for t in lidars
    )
    # A slow IMU would otherwise have its whole recording read: after three seconds a few samples do.
    wanted = PROBE_SAMPLES if elapsed < FULL_PROBE_NS else MIN_SAMPLES
    return clouds and all(len(probe.samples.get(t.name, ())) >= min(wanted, t.count) for t in imus)


def _choose_lidar(lidars: list[TopicInfo], probe: _Probe, wanted: str) -> tuple[str | None, list[Note]]:
    """Take the topic with the most points."""
    if not lidars:
        return None, []
    if wanted:
        return wanted, [make_inference("lidar topic", wanted, "--lidar-topic", source="override")]
    points = {t.name: t.count * _cloud_size(probe.clouds.get(t.name, [])) for t in lidars}
    best = max(sorted(points), key=lambda name: points[name])
    if len(lidars) == 1:
        return best, [
            make_inference("lidar topic", best, f"the only one, {lidars[0].count} messages of {lidars[0].message_type}")
        ]
    listing = ", ".join(f"{name} (about {points[name]:.3g} points)" for name in sorted(points))
    message = (
        f"{len(lidars)} LiDAR topics: {listing}; {best} is used, it has the most points; choose with --lidar-topic"
    )
    return best, [
        make_inference("lidar topic", best, f"most points of {listing}"),
        Event(code="lidar-topics", message=message),
    ]


def _cloud_size(clouds: list[RawCloud]) -> float:
    return float(np.median([c.points or 0 for c in clouds])) if clouds else 0.0


def _choose_imu(imus: list[TopicInfo], probe: _Probe, wanted: str) -> tuple[str | None, list[Note]]:
    """Take the topic with the most samples."""
    if not imus:
        return None, []
    if wanted:
        return wanted, [make_inference("imu topic", wanted, "--imu-topic", source="override")]
    counts = {t.name: t.count if probe.samples.get(t.name) else 0 for t in imus}
    best = max(sorted(counts), key=lambda name: counts[name])
    if len(imus) == 1:
        return best, [make_inference("imu topic", best, f"the only one, {imus[0].count} messages")]
    listing = ", ".join(f"{name} ({counts[name]} samples)" for name in sorted(counts))
    message = f"{len(imus)} IMU topics: {listing}; {best} is used, it has the most samples; choose with --imu-topic"
    return best, [
        make_inference("imu topic", best, f"most samples of {listing}"),
        Event(code="imu-topics", message=message),
    ]


def _read_lidar(clouds: Sequence[RawCloud], config: InputConfig) -> tuple[PointTiming, list[Note]]:
    if not clouds:
        return PointTiming(), []
    result = infer_timing(clouds, config)
    return result.timing, [*result.inferences, *result.events, *_byte_order(clouds)]


def _byte_order(clouds: Sequence[RawCloud]) -> list[Note]:
    count = sum(cloud.swapped for cloud in clouds)
    if not count:
        return []
    message = (
        f"{clouds[0].topic}: is_bigendian says the wrong byte order in {count} of the first {len(clouds)} scans, whose "
        "coordinates are lengths only in the other; that one is used; mend the driver or the exporter that sets it"
    )
    return [Event(code="byte-order", message=message)]


def _read_imu(samples: Sequence[RawImu], config: InputConfig) -> tuple[ImuUnits | None, int, str, list[Note]]:
    """Return units, period [ns], the stamp to use, and what led to them."""
    if not samples:
        return None, DEFAULT_IMU_PERIOD_NS, "header", []
    units = infer_imu_units(samples, config)
    period_ns, stamp, notes = _imu_period(samples)
    return units, period_ns, stamp, [*notes, *units.inferences, *units.events]


def _imu_period(samples: Sequence[RawImu]) -> tuple[int, str, list[Note]]:
    """Return the period [ns], the stamp to use, and what led to them."""
    topic, stamp = samples[0].topic, "header"
    notes: list[Note] = []
    steps = np.diff(np.array([s.stamp_ns for s in samples], dtype=np.int64))
    backwards = int(np.count_nonzero(steps < 0))
    if len(steps) >= 3 and backwards > len(steps) // 2:
        raise DataError(
            f"{topic}: IMU stamps run backwards ({backwards} of the first {len(steps)} steps); re-record or sort "
            "the messages by stamp"
        )
    if len(steps) >= 3 and not steps.any():
        stamp = "received"
        steps = np.diff(np.array([s.received_ns for s in samples], dtype=np.int64))
        message = f"{topic}: IMU stamps do not advance; times of reception are used, which jitter"
        notes.append(Event(code="no-stamps", message=message))
    steps = steps[steps > 0]
    if not len(steps):
        return (
            DEFAULT_IMU_PERIOD_NS,
            stamp,
            [*notes, make_inference("imu rate", "unknown", "one sample", source="default")],
        )
    period = int(np.median(steps))
    evidence = f"median of {len(steps)} steps between stamps, {steps.min() / 1e6:.3f} to {steps.max() / 1e6:.3f} ms"
    return period, stamp, [*notes, make_inference("imu rate", f"{1e9 / period:.4g} Hz", evidence)]


def _clock_mismatch(apart: ImuClock | None, *, mended: bool) -> list[Note]:
    """Warn where LiDAR and IMU stamp in clocks that differ: what arrives together is stamped apart."""
    if apart is None:
        return []
    then = "the IMU's samples are brought to the LiDAR's clock by the times of reception, and then by the turns; "
    message = (
        f"LiDAR stamps are {-apart.offset:+.3f} s off IMU stamps of messages that arrive together: the sensors' clocks "
        f"differ; {then if mended else ''}synchronise them (PTP, or the driver's option to stamp with the computer's "
        "time) for the next recording"
    )
    return [Event(code="clock-mismatch", message=message)]
