"""From a raw cloud to a `Scan`: points that are there, and the time of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.data import Scan
from heliograph.errors import DataError
from heliograph.guard.limits import MAX_NS
from heliograph.io.inference.layouts import INTENSITY_FIELDS, RING_FIELDS
from heliograph.io.raw import RawCloud

__all__ = ["TOLERANT", "PointTiming", "azimuth_offsets", "to_scan", "valid_points"]

MAX_SWEEP_NS = 2_000_000_000


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
        Unit of that column [ns].
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


def valid_points(cloud: RawCloud) -> tuple[NDArray[np.float32], NDArray[np.uint32] | None]:
    """Return the finite, non-zero points of a cloud and which they are.

    Returns
    -------
    points : (N, 3) float32
        In the lidar frame [m].
    kept : (N,) uint32 or None
        Their indices in storage order; None when all points are valid.

    Raises
    ------
    DataError
        The cloud has no coordinates.
    """
    x, y, z = _axes(cloud)
    points, kept, *_ = _core.decode_points(x, y, z, None, None, None)
    return points, None if len(kept) == x.size else kept


def _axes(cloud: RawCloud) -> tuple[NDArray[np.generic], NDArray[np.generic], NDArray[np.generic]]:
    try:
        x, y, z = (_plain(cloud.columns[name]) for name in ("x", "y", "z"))
    except KeyError as error:
        raise DataError(
            f"{cloud.topic}: a cloud without field {error} cannot be used; it has {list(cloud.columns)}"
        ) from None
    return x, y, z


@TOLERANT
def _plain(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a column in a type that the native decoder reads: native floats, integers of up to 32 bits."""
    kind, size = column.dtype.kind, column.dtype.itemsize
    if column.dtype.isnative and ((kind == "f" and size in (4, 8)) or (kind in "iu" and size <= 4)):
        return column
    return column.astype(f"={kind}{size}" if kind in "iu" and size <= 4 else np.float64)


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
    x, y, z = _axes(cloud)
    has_times = timing.method == "field" and timing.field in cloud.columns
    column, origin = _time_column(cloud, timing, x.shape)
    intensity = next((n for n in INTENSITY_FIELDS if n in cloud.columns), None)
    ring = next((n for n in RING_FIELDS if n in cloud.columns and cloud.columns[n].dtype.kind in "iu"), None)
    points, _, times, first, intensities, rings = _core.decode_points(
        x,
        y,
        z,
        column,
        None if intensity is None else _plain(cloud.columns[intensity]),
        None if ring is None else _plain(cloud.columns[ring]),
    )
    inside = None
    if has_times:
        start_ns, offsets, inside = _field_times(times, first, origin, timing, header_ns)
    else:
        start_ns, offsets = header_ns - timing.shift_ns, _geometric_offsets(points, times, timing)
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
        has_point_times=has_times,
    )


def _time_column(
    cloud: RawCloud, timing: PointTiming, shape: tuple[int, ...]
) -> tuple[NDArray[np.generic] | None, int]:
    """Return the column to time the points with, less an origin in the column's unit, and the origin."""
    if timing.method == "field" and timing.field in cloud.columns:
        times = cloud.columns[timing.field]
        if times.dtype.kind not in "iu" or times.dtype.itemsize <= 4 or times.size == 0:
            return _plain(times), 0
        # An epoch in nanoseconds has more digits than a double; the differences within a sweep have not.
        origin = int(times.min())
        return (times - times.dtype.type(origin)).astype(np.float64), origin
    if timing.method == "columns" and len(shape) == 2:
        column_ns = (np.arange(shape[1]) * (timing.period_ns / shape[1])).astype(np.int32)
        return np.broadcast_to(column_ns, shape), 0
    return None, 0


def _field_times(
    times: NDArray[np.float64], first: float, origin: int, timing: PointTiming, header_ns: int
) -> tuple[int, NDArray[np.int32], NDArray[np.bool_] | None]:
    """Return the sweep's start [ns], the offsets from it, and the points whose offset is plausible (None: all).

    ``times`` (N,) count from ``origin`` in the field's unit, ``first`` is the least finite one, infinite if none is.
    """
    if not np.isfinite(first):
        return header_ns - timing.shift_ns, np.zeros(len(times), np.int32), None
    if abs(first) * timing.ns_per_unit > MAX_NS or abs(origin) * timing.ns_per_unit > MAX_NS:
        raise DataError(f"field '{timing.field}' holds {first + origin:.3g}, which is no time")
    first_ns = _exact_ns(first, timing.ns_per_unit) + origin * int(timing.ns_per_unit)
    if timing.reference == "header" and first_ns >= 0 and timing.shift_ns == 0:
        # Times from the header stamp on: the sweep starts at the stamp even where its first points are missing.
        first, first_ns = -float(origin), 0
    offsets, _, outside = _core.sweep_offsets(times, first, timing.ns_per_unit, MAX_SWEEP_NS)
    inside = (times - first) * timing.ns_per_unit <= MAX_SWEEP_NS if outside else None
    if timing.reference == "absolute":
        return first_ns, offsets, inside
    begin = first_ns if timing.reference == "header" else 0
    return header_ns + begin - timing.shift_ns, offsets, inside


def _exact_ns(value: float, ns_per_unit: float) -> int:
    """Return a time in nanoseconds without losing the digits of an epoch in seconds."""
    whole = int(np.floor(value))
    return whole * int(ns_per_unit) + round((value - whole) * ns_per_unit)


def _geometric_offsets(
    points: NDArray[np.float32], column_ns: NDArray[np.float64] | None, timing: PointTiming
) -> NDArray[np.int32]:
    if column_ns is not None:
        return column_ns.astype(np.int32)
    if timing.method == "azimuth" and len(points):
        return azimuth_offsets(points, timing)
    return np.zeros(len(points), np.int32)


def azimuth_offsets(points: NDArray[np.float32], timing: PointTiming) -> NDArray[np.int32]:
    """Return the time of each point since its sweep's start, from its azimuth.

    Parameters
    ----------
    points : (N, 3) float32
        Points of a spinning lidar, in its frame [m]; N > 0.
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
