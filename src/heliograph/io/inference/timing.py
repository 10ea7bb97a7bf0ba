"""Which field times the points, in which unit, from when: decided from the first clouds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.config import InputConfig
from heliograph.data import Event
from heliograph.errors import ConfigError, DataError, closest
from heliograph.io.inference.layouts import DESKEWED_LAYOUTS, UNITS, Layout, find_layout, time_field
from heliograph.io.inference.record import Inference, make_inference
from heliograph.io.inference.scans import TOLERANT, PointTiming, valid_points
from heliograph.io.raw import RawCloud

__all__ = ["TimingResult", "infer_timing"]

DEFAULT_PERIOD_NS = 100_000_000
MIN_POINTS = 100
MAX_RUNAWAY_NS = 100_000_000_000  # beyond it a time is no offset that runs on, but a clock's
MAX_STAMP_DISTANCE_NS = (
    10_000_000_000  # an absolute time further than this from the header stamp counts in another clock
)


@dataclass(frozen=True, slots=True)
class TimingResult:
    """The timing with what led to it."""

    timing: PointTiming
    inferences: tuple[Inference, ...]
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class _Spans:
    """Earliest and latest raw time of each probed cloud's valid points, and the stamps."""

    first: NDArray[np.float64]
    last: NDArray[np.float64]
    stamps_ns: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)


@TOLERANT
def infer_timing(clouds: Sequence[RawCloud], config: InputConfig) -> TimingResult:
    """Infer how the points of a topic are timed.

    Parameters
    ----------
    clouds : sequence of RawCloud
        The topic's first messages, at least one.
    config : InputConfig
        Overrides.

    Raises
    ------
    ConfigError
        The overriding field does not exist.
    DataError
        The clouds have no coordinates, or their header stamps run backwards.
    """
    valid_points(clouds[0])  # refuses a cloud without coordinates
    stamp, events = _stamp_source(clouds)
    period_ns, inferences = _period(clouds, stamp)
    field = _field(clouds, config)
    base = PointTiming(period_ns=period_ns, stamp=stamp)
    spans = _measure(clouds, field, stamp) if field else None
    if spans is None or field is None or not np.any(spans.last > spans.first):
        result = _without_field(clouds, base, field, config)
    else:
        result = _with_field(clouds, base, field, spans, config)
    stamped = make_inference("scan stamp", stamp, "header stamps advance" if stamp == "header" else events[0].message)
    return TimingResult(
        result.timing,
        (*inferences, *([] if stamp == "header" else [stamped]), *result.inferences),
        (*events, *result.events),
    )


def _stamp_source(clouds: Sequence[RawCloud]) -> tuple[str, list[Event]]:
    stamps = np.array([c.stamp_ns for c in clouds], dtype=np.int64)
    steps = np.diff(stamps)
    topic = clouds[0].topic
    if len(steps) >= 3 and np.count_nonzero(steps < 0) > len(steps) // 2:
        raise DataError(
            f"{topic}: header stamps run backwards ({np.count_nonzero(steps < 0)} of the first {len(steps)} steps, "
            f"median {np.median(steps) / 1e9:.3f} s); re-record or sort the messages by stamp"
        )
    if stamps.max() <= 0 or (len(steps) >= 2 and not steps.any()):
        message = (
            f"{topic}: header stamps do not advance (first {stamps[0]}); times of reception are used, which jitter"
        )
        return "received", [Event(code="no-stamps", message=message)]
    return "header", []


def _period(clouds: Sequence[RawCloud], stamp: str) -> tuple[int, list[Inference]]:
    times = np.array([c.stamp_ns if stamp == "header" else c.received_ns for c in clouds], dtype=np.int64)
    steps = np.diff(times)
    steps = steps[steps > 0]
    if not len(steps):
        text = f"{DEFAULT_PERIOD_NS / 1e9:.3f} s"
        return DEFAULT_PERIOD_NS, [
            make_inference("sweep period", text, "one scan only: the usual 10 Hz", source="default")
        ]
    period = int(np.median(steps))
    evidence = f"median of {len(steps)} steps between stamps, {steps.min() / 1e9:.4f} to {steps.max() / 1e9:.4f} s"
    return period, [make_inference("sweep period", f"{period / 1e9:.4f} s", evidence)]


def _field(clouds: Sequence[RawCloud], config: InputConfig) -> str | None:
    columns = clouds[0].columns
    wanted = config.point_time_field
    if wanted and wanted not in columns:
        valid = ", ".join(columns)
        raise ConfigError(
            f"input.point_time_field: no field '{wanted}' in {clouds[0].topic} ({valid}){closest(wanted, columns)}"
        )
    return wanted or time_field(columns)


def _measure(clouds: Sequence[RawCloud], field: str, stamp: str) -> _Spans | None:
    rows = []
    for cloud in clouds:
        column = cloud.columns.get(field)
        _, kept = valid_points(cloud)
        if column is None or column.dtype.kind not in "iuf":
            continue
        times = column.reshape(-1) if kept is None else column.reshape(-1)[kept]
        if times.dtype.kind == "f":
            times = times[np.isfinite(times)]
        if len(times) > 1:
            at = cloud.stamp_ns if stamp == "header" else cloud.received_ns
            rows.append((float(times.min()), float(times.max()), at))
    if not rows:
        return None
    first, last, stamps = zip(*rows, strict=True)
    return _Spans(np.array(first), np.array(last), np.array(stamps, dtype=np.int64))


def _with_field(
    clouds: Sequence[RawCloud], base: PointTiming, field: str, spans: _Spans, config: InputConfig
) -> TimingResult:
    layout = find_layout(clouds[0].layout, clouds[0].columns)
    if layout is not None and layout.field != field:
        layout = None
    dtype = clouds[0].columns[field].dtype
    chosen = "override" if config.point_time_field else "data"
    driver = f"as {layout.name} drivers write it (header stamp: {layout.stamp})" if layout else "by its name"
    inferences = [make_inference("point time field", field, f"{dtype.name}, {driver}", source=chosen)]
    unit, unit_inference, events = _unit(spans, base.period_ns, layout, config.point_time_unit)
    timing = replace(base, method="field", field=field, ns_per_unit=UNITS[unit])
    timing, reference_inference, more = _reference(timing, spans, clouds, config.point_time_reference)
    if layout is not None and not config.point_time_reference:
        more = [*more, *_check_reference(timing, layout)]
    return TimingResult(timing, (*inferences, unit_inference, *reference_inference), (*events, *more))


def _check_reference(timing: PointTiming, layout: Layout) -> list[Event]:
    words = {"header": "counted from the header stamp", "absolute": "absolute", "other-clock": "absolute"}
    expected, found = words[layout.reference], words[timing.reference]
    if expected == found:
        return []
    message = (
        f"'{layout.field}' of {layout.name} drivers is {expected}, but in this recording it is {found}; set "
        "input.point_time_reference to overrule"
    )
    return [Event(code="point-time-reference", message=message)]


def _unit(spans: _Spans, period_ns: int, layout: Layout | None, override: str) -> tuple[str, Inference, list[Event]]:
    span = float(np.median((spans.last - spans.first)[spans.last > spans.first]))
    ratios = {unit: span * ns / period_ns for unit, ns in UNITS.items()}
    if override:
        text = f"the sweep spans {ratios[override]:.3g} periods in it"
        return override, make_inference("point time unit", override, text, source="override"), []
    unit = min(ratios, key=lambda u: abs(math.log10(ratios[u])))
    evidence = f"a sweep spans {span:.6g}, {ratios[unit]:.3g} of the {period_ns / 1e9:.4f} s from scan to scan"
    events = []
    if layout is not None and unit != layout.unit:
        message = (
            f"per-point times are in {unit}, not in {layout.unit} as '{layout.field}' of {layout.name} drivers "
            "should be: "
            f"{evidence}; set input.point_time_unit to overrule"
        )
        events.append(Event(code="point-time-unit", message=message))
    if not 0.05 < ratios[unit] < 2.5:
        message = (
            f"the unit of the per-point times is doubtful: {evidence}; set input.point_time_unit if '{unit}' is wrong"
        )
        events.append(Event(code="point-time-span", message=message))
    return unit, make_inference("point time unit", unit, evidence), events


def _reference(
    timing: PointTiming, spans: _Spans, clouds: Sequence[RawCloud], override: str
) -> tuple[PointTiming, list[Inference], list[Event]]:
    """Decide from when the times count, and so what the header stamp means."""
    scale = timing.ns_per_unit
    low, high = float(np.median(spans.first)) * scale, float(np.median(spans.last)) * scale
    span = high - low
    if not override and _runs_on(spans, scale, timing.period_ns):
        return _runaway(timing, spans)
    if override == "absolute" or (not override and abs(low) > 20 * max(timing.period_ns, span)):
        return _absolute(timing, spans, override)
    shift = {"start": min(low, 0.0), "middle": (low + high) / 2, "end": high}.get(override, 0.0)
    # A few microseconds of firing delay do not make a signed time.
    margin = 0.02 * span
    if override:
        meaning, source = override, "override"
    else:
        source = "data"
        meaning = "start" if low >= -margin else "end" if high <= margin else "middle"
        if abs((low + high) / 2) > 0.15 * span and meaning == "middle":
            meaning = "inside"
    timing = replace(timing, shift_ns=round(shift))
    evidence = f"times run from {low / 1e6:.2f} to {high / 1e6:.2f} ms from the header stamp"
    events = [] if override else _check_latency(timing, clouds, meaning, high)
    words = {
        "start": "the sweep's start",
        "middle": "its middle",
        "end": "its end (times are negative)",
        "inside": "inside it",
    }
    return (
        timing,
        [
            make_inference("point time reference", f"header stamp, {meaning}", evidence, source=source),
            make_inference("scan stamp", words[meaning], evidence, source=source),
        ],
        events,
    )


def _runs_on(spans: _Spans, scale: float, period_ns: int) -> bool:
    """Whether times that should begin anew with each scan run on from scan to scan, in no clock of the stamps'."""
    first, span = spans.first * scale, float(np.median(spans.last - spans.first)) * scale
    steps, stamped = np.diff(first), np.diff(spans.stamps_ns)
    if len(steps) < 3 or abs(float(np.median(first))) > MAX_RUNAWAY_NS or span > 1.5 * period_ns:
        return False
    return bool(np.ptp(first) > 2.0 * span and np.median(np.abs(steps - stamped)) < 0.2 * period_ns)


def _runaway(timing: PointTiming, spans: _Spans) -> tuple[PointTiming, list[Inference], list[Event]]:
    reach = float(np.ptp(spans.first)) * timing.ns_per_unit * 1e-9
    evidence = f"the first time of a scan grows by {reach:.2f} s over {len(spans.first)} scans"
    message = (
        f"the per-point times run on from scan to scan instead of beginning anew ({evidence}): within a scan they are "
        "used, each sweep is taken to start at its header stamp; update the driver"
    )
    found = [make_inference("point time reference", "runs on, sweep starts at the header stamp", evidence)]
    return replace(timing, reference="other-clock"), found, [Event(code="point-time-runaway", message=message)]


def _absolute(timing: PointTiming, spans: _Spans, override: str) -> tuple[PointTiming, list[Inference], list[Event]]:
    source = "override" if override else "data"
    before = spans.stamps_ns - spans.first * timing.ns_per_unit  # header stamp past the first point
    lag = float(np.median(before))
    span = float(np.median(spans.last - spans.first)) * timing.ns_per_unit
    if abs(lag) < MAX_STAMP_DISTANCE_NS or override:
        evidence = f"the first point is {lag / 1e6:.2f} ms before the header stamp"
        share = lag / span if span > 0 else 0.0
        meaning = (
            "start"
            if abs(share) < 0.25
            else "middle"
            if abs(share - 0.5) < 0.25
            else "end"
            if abs(share - 1) < 0.25
            else "apart"
        )
        words = {
            "start": "the sweep's start",
            "middle": "its middle",
            "end": "its end",
            "apart": "apart from the sweep",
        }[meaning]
        found = [
            make_inference("point time reference", "absolute", evidence, source=source),
            make_inference("scan stamp", words, evidence),
        ]
        return replace(timing, reference="absolute"), found, []
    message = (
        f"per-point times are absolute in another clock, {abs(lag) / 1e9:.1f} s from the header stamps; the sweep "
        "is taken to start "
        "at its header stamp; set input.point_time_reference to overrule"
    )
    found = [
        make_inference(
            "point time reference", "absolute, another clock", f"{abs(lag) / 1e9:.1f} s from the header stamps"
        )
    ]
    return replace(timing, reference="other-clock"), found, [Event(code="point-clock", message=message)]


def _check_latency(timing: PointTiming, clouds: Sequence[RawCloud], meaning: str, high: float) -> list[Event]:
    """Warn where messages arrived before their last point was measured: then the stamp cannot mean what it seems to."""
    if meaning != "start" or timing.stamp != "header":
        return []
    latency = np.array([c.received_ns - c.stamp_ns for c in clouds], dtype=np.float64)
    # Equal times are a converter's, and far ones another clock's: neither says anything.
    if len(latency) < 3 or not np.all((latency > 1_000_000) & (latency < 0.7 * high)):
        return []
    message = (
        f"scans were received {np.median(latency) / 1e6:.1f} ms after their stamp although a sweep lasts "
        f"{high / 1e6:.1f} ms: the "
        "stamp may mean the sweep's end; compare with input.point_time_reference=end"
    )
    return [Event(code="scan-stamp", message=message)]


def _without_field(
    clouds: Sequence[RawCloud], base: PointTiming, field: str | None, config: InputConfig
) -> TimingResult:
    """Time the points from the sweep's geometry where that is clear, else not at all."""
    if clouds[0].layout in DESKEWED_LAYOUTS:
        evidence = "the scans are already free of motion distortion"
        return TimingResult(replace(base, method="none"), (make_inference("point time field", "none", evidence),), ())
    cause = f"field '{field}' is constant" if field else f"none of the fields {list(clouds[0].columns)} is a time"
    method, direction, evidence = _sweep_geometry(clouds)
    at_end = _stamped_at_end(clouds, base) if config.repair and method != "none" else None
    timing = replace(base, method=method, direction=direction, shift_ns=0 if at_end is None else base.period_ns)
    if method == "azimuth":
        timing = replace(timing, azimuth=_first_azimuth(clouds, direction))
    value = {"columns": "none: inferred from the column", "azimuth": "none: inferred from the azimuth", "none": "none"}[
        method
    ]
    if method == "none":
        consequence = "all points count as measured at the header stamp, fast motion smears"
    else:
        side = "end" if at_end else "start"
        consequence = f"inferred from the sweep's geometry ({evidence}), the header stamp taken as its {side}"
    message = f"no per-point time ({cause}): {consequence}; record with a driver that writes it"
    inferences = (
        make_inference("point time field", value, f"{cause}; {evidence}"),
        make_inference("scan stamp", "the sweep's end", at_end)
        if at_end
        else make_inference("scan stamp", "the sweep's start", "nothing in the data tells", source="default"),
    )
    events = [Event(code="no-point-time", message=message)]
    if at_end:
        text = f"the header stamps mean the sweep's end: {at_end}; each sweep is taken to end there"
        events.append(Event(code="scan-stamp", message=text))
    return TimingResult(timing, inferences, tuple(events))


def _stamped_at_end(clouds: Sequence[RawCloud], timing: PointTiming) -> str | None:
    """Return the evidence that the header stamps mean the sweep's end; None where nothing tells.

    A whole sweep cannot be received before it was measured. Equal times are a converter's and tell nothing.
    """
    if timing.stamp != "header":
        return None
    latency = np.array([c.received_ns - c.stamp_ns for c in clouds], dtype=np.float64)
    if len(latency) < 3 or not np.all((latency > 50_000) & (latency < 0.5 * timing.period_ns)):
        return None
    return (
        f"scans were received {np.median(latency) / 1e6:.1f} ms after their stamp although a sweep lasts "
        f"{timing.period_ns / 1e6:.1f} ms"
    )


def _sweep_geometry(clouds: Sequence[RawCloud]) -> tuple[str, int, str]:
    """Return method, direction and evidence of a spinning lidar's sweep."""
    votes = [_turn(cloud) for cloud in clouds if len(valid_points(cloud)[0]) >= MIN_POINTS][:5]
    if not votes:
        return "none", 1, "too few points"
    agreed = [v for v in votes if v[0] == votes[0][0] and v[1] == votes[0][1]]
    if votes[0][0] == "none" or len(agreed) < len(votes):
        return "none", 1, "no steady turn in the azimuths" if votes[0][0] == "none" else "the scans disagree"
    return votes[0]


def _first_azimuth(clouds: Sequence[RawCloud], direction: int) -> float | None:
    """Return the azimuth at which all sweeps start, None where they start anywhere."""
    firsts = [points[0] for points, _ in map(valid_points, clouds) if len(points)]
    azimuths = np.array([math.atan2(y, x) for x, y, _ in firsts])
    spread = np.angle(np.exp(1j * (azimuths - azimuths[0])))
    # The first beam of a sweep may be lost, so that a sweep seems to start late but never early.
    return float(azimuths[0] + direction * (direction * spread).min()) if np.ptp(spread) < 0.1 else None


def _turn(cloud: RawCloud) -> tuple[str, int, str]:
    x, y = cloud.columns["x"], cloud.columns["y"]
    if x.ndim == 2 and x.shape[1] >= 64:
        azimuth = np.arctan2(y.astype(np.float64), x.astype(np.float64))
        usable = np.isfinite(azimuth) & ((np.abs(x) + np.abs(y)) > 0)
        row = int(np.count_nonzero(usable, axis=1).argmax())
        progress, steady = _progress(azimuth[row][usable[row]])
        if abs(abs(progress) - 1) < 0.1 and steady > 0.9:
            sign = 1 if progress > 0 else -1
            return "columns", sign, f"{x.shape[1]} columns turn {progress:+.2f} times"
        return "none", 1, "columns do not turn"
    points, _ = valid_points(cloud)
    azimuth = np.arctan2(points[:, 1].astype(np.float64), points[:, 0].astype(np.float64))
    progress, steady = _progress(azimuth)
    if abs(progress) > 0.9 and steady > 0.9:
        return (
            "azimuth",
            1 if progress > 0 else -1,
            f"the azimuth turns {progress:+.1f} times through the stored points",
        )
    return "none", 1, "the azimuth does not turn"


def _progress(azimuth: NDArray[np.float64]) -> tuple[float, float]:
    """Return how often the azimuth turns, and the share of its movement in the prevailing direction."""
    steps = np.diff(azimuth)
    steps = (steps + np.pi) % (2 * np.pi) - np.pi
    moved = float(np.abs(steps).sum())
    progress = float(steps.sum())
    steady = float(np.abs(steps[np.sign(steps) == np.sign(progress)]).sum()) / moved if moved > 0 else 0.0
    return progress / (2 * np.pi), steady
