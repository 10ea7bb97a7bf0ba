"""From a raw cloud to a `Scan`: points that are there, and the time of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Scan
from heliograph.errors import DataError
from heliograph.io.layouts import INTENSITY_FIELDS, RING_FIELDS
from heliograph.io.raw import RawCloud

__all__ = ["TOLERANT", "PointTiming", "azimuth_offsets", "to_scan", "valid_points"]

LONGEST_SWEEP_NS = 2_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class PointTiming:
    """How to get the time of each point.

    Parameters
    ----------
    method : str
        ``"field"``; ``"columns"`` or ``"azimuth"`` where no field exists and the sweep's geometry tells; ``"none"``.
    field : str
        Column of the times, for ``"field"``.
    ns_per_unit : float
        Of that column [ns].
    reference : str
        ``"header"``: a point was measured at the header stamp plus its time minus ``shift_ns``; ``"absolute"``: at
        its time; ``"other-clock"``: its time counts in a clock of its own, the earliest point is at the header stamp
        minus ``shift_ns``.
    shift_ns : int
        Constant part of the above [ns].
    period_ns : int
        From one sweep to the next [ns].
    direction : int
        +1 where the azimuth grows during a sweep, else -1.
    azimuth : float or None
        At which every sweep starts [rad]; None: at its first stored point's.
    stamp : str
        ``"header"``, or ``"received"`` where headers carry no usable stamp.
    """

    method: str = "none"
    field: str = ""
    ns_per_unit: float = 1.0
    reference: str = "header"
    shift_ns: int = 0
    period_ns: int = 100_000_000
    direction: int = 1
    azimuth: float | None = None
    stamp: str = "header"


# Any bit pattern may come in: what is not a number fails the comparisons below and is dropped, silently.
TOLERANT = np.errstate(invalid="ignore", over="ignore")


@TOLERANT
def valid_points(cloud: RawCloud) -> tuple[NDArray[np.float32], NDArray[np.intp] | None]:
    """Return the finite, non-zero points of a cloud and which they are.

    Returns
    -------
    points : (N, 3) float32
        In the lidar frame [m].
    kept : (N,) intp or None
        Their indices in storage order; None when all points are valid.
    """
    try:
        axes = [cloud.columns[name] for name in ("x", "y", "z")]
    except KeyError as error:
        raise DataError(
            f"{cloud.topic}: a cloud without field {error} cannot be used; it has {list(cloud.columns)}"
        ) from None
    points = np.empty((axes[0].size, 3), np.float32)
    for column, axis in enumerate(axes):
        points[:, column].reshape(axis.shape)[...] = axis
    extent = np.abs(points[:, 0])
    extent += np.abs(points[:, 1])
    extent += np.abs(points[:, 2])
    valid = (extent > 0.0) & (extent < np.inf)  # NaN compares false with both
    kept = np.flatnonzero(valid)  # taking by index is several times as fast as masking
    if len(kept) == len(points):
        return points, None
    return points.take(kept, axis=0), kept


def _column(cloud: RawCloud, name: str, kept: NDArray[np.intp] | None) -> NDArray[np.generic]:
    column = cloud.columns[name].reshape(-1)
    return column if kept is None else column.take(kept)


@TOLERANT
def to_scan(cloud: RawCloud, timing: PointTiming) -> Scan:
    """Convert one message.

    Parameters
    ----------
    cloud : RawCloud
        As decoded.
    timing : PointTiming
        How its points are timed.

    Returns
    -------
    Scan
        Without points that are NaN, infinite or zero, or whose time is not within 2 s of the sweep's start.
    """
    header_ns = cloud.stamp_ns if timing.stamp == "header" else cloud.received_ns
    points, kept = valid_points(cloud)
    if timing.method == "field" and timing.field in cloud.columns:
        start_ns, offsets, inside = _field_times(_column(cloud, timing.field, kept), timing, header_ns)
    else:
        start_ns, offsets, inside = header_ns - timing.shift_ns, _geometric_offsets(cloud, points, kept, timing), None
    intensity = next((n for n in INTENSITY_FIELDS if n in cloud.columns), None)
    ring = next((n for n in RING_FIELDS if n in cloud.columns and cloud.columns[n].dtype.kind in "iu"), None)
    intensities = _column(cloud, intensity, kept).astype(np.float32) if intensity else None
    rings = _column(cloud, ring, kept).astype(np.uint16) if ring else None
    if inside is not None:
        points, offsets = points[inside], offsets[inside]
        intensities = None if intensities is None else intensities[inside]
        rings = None if rings is None else rings[inside]
    return Scan(
        stamp_ns=start_ns,
        header_stamp_ns=header_ns,
        received_ns=cloud.received_ns,
        end_ns=start_ns + (int(offsets.max()) if len(offsets) else 0),
        points=points,
        offsets_ns=offsets,
        intensity=intensities,
        ring=rings,
        frame_id=cloud.frame_id or "lidar",
        has_point_times=timing.method == "field" and timing.field in cloud.columns,
    )


def _field_times(
    times: NDArray[np.generic], timing: PointTiming, header_ns: int
) -> tuple[int, NDArray[np.int32], NDArray[np.bool_] | None]:
    """Return the sweep's start [ns], the offsets from it, and the points whose offset is plausible (None: all)."""
    if len(times) == 0:
        return header_ns - timing.shift_ns, np.empty(0, np.int32), None
    if times.dtype.kind == "f":
        # Single precision carries a tenth of a microsecond over a sweep; the difference below needs double for epochs.
        values = times.astype(np.float64)
        if not np.isfinite(values.sum()):
            values = np.where(np.isfinite(values), values, np.inf)
    else:
        values = times.astype(np.int64)
    first = values.min()
    if not np.isfinite(first):
        return header_ns - timing.shift_ns, np.zeros(len(times), np.int32), None
    first_ns = _exact_ns(first, timing.ns_per_unit)
    if timing.reference == "header" and first_ns >= 0 and timing.shift_ns == 0:
        # Times from the header stamp on: the sweep starts at the stamp even where its first points are missing.
        first, first_ns = values.dtype.type(0), 0
    relative = (values - first) * timing.ns_per_unit
    largest = float(relative.max())
    inside = None
    if largest > LONGEST_SWEEP_NS:
        inside = relative <= LONGEST_SWEEP_NS
        relative = np.where(inside, relative, 0.0)
    offsets = np.rint(relative).astype(np.int32) if relative.dtype.kind == "f" else relative.astype(np.int32)
    if timing.reference == "absolute":
        return first_ns, offsets, inside
    origin = first_ns if timing.reference == "header" else 0
    return header_ns + origin - timing.shift_ns, offsets, inside


def _exact_ns(value: float | np.generic, ns_per_unit: float) -> int:
    """Return a time in nanoseconds without losing the digits of an epoch in seconds."""
    if isinstance(value, np.integer):
        return int(value) * int(ns_per_unit)
    whole = int(np.floor(float(value)))
    return whole * int(ns_per_unit) + round((float(value) - whole) * ns_per_unit)


def _geometric_offsets(
    cloud: RawCloud, points: NDArray[np.float32], kept: NDArray[np.intp] | None, timing: PointTiming
) -> NDArray[np.int32]:
    if timing.method == "columns" and cloud.columns["x"].ndim == 2:
        height, width = cloud.columns["x"].shape
        column_ns = (np.arange(width) * (timing.period_ns / width)).astype(np.int32)
        offsets = np.broadcast_to(column_ns, (height, width)).reshape(-1)
        return np.ascontiguousarray(offsets if kept is None else offsets[kept])
    if timing.method == "azimuth" and len(points):
        return azimuth_offsets(points, timing)
    return np.zeros(len(points), np.int32)


def azimuth_offsets(points: NDArray[np.float32], timing: PointTiming) -> NDArray[np.int32]:
    """Return the time of each point since its sweep's start, from its azimuth.

    Parameters
    ----------
    points : (N, 3) float32
        Of a spinning lidar, in its frame [m]; N > 0.
    timing : PointTiming
        Direction, starting azimuth and period.
    """
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    origin = azimuth[0] if timing.azimuth is None else np.float32(timing.azimuth)
    turn = np.float32(2 * np.pi)
    phase = np.mod(timing.direction * (azimuth - origin), turn) / turn
    # Points a hair before the origin belong to the sweep's start, not to its end.
    phase[phase > 0.9995] = 0.0
    offsets: NDArray[np.int32] = (phase * np.float32(timing.period_ns)).astype(np.int32)
    return offsets
