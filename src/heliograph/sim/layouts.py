"""Point messages as the drivers write them: fields, offsets, order of the points, and what the stamps mean.

The tables follow the drivers' own sources: ouster-ros (``os_point.h``, ``point_cloud_compose.h``), velodyne
(``pointcloudXYZIRT``, ``datacontainerbase.hpp``), HesaiLidar_ROS_2.0 (``source_driver_ros2.hpp``), rslidar_sdk
(``source_pointcloud_ros.hpp``), livox_ros_driver2 (``lddc.cpp``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.errors import ConfigError, closest
from heliograph.sim.simulate import Sweep

__all__ = ["LAYOUTS", "PackedCloud", "SimulatedLayout", "find_layout"]

_Fields = list[tuple[str, str, int]]
_NAN = np.float32(np.nan)
_XYZ: _Fields = [("x", "<f4", 0), ("y", "<f4", 4), ("z", "<f4", 8)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedCloud:
    """A cloud as it lies in a message.

    Parameters
    ----------
    stamp_ns : int
        The header's stamp [ns].
    height, width : int
        Organisation.
    points : structured array
        The message's data.
    is_dense : bool
        The message's own claim that no point is invalid.
    """

    stamp_ns: int
    height: int
    width: int
    points: NDArray[np.void]
    is_dense: bool

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedLayout:
    """How one driver writes a sweep.

    Parameters
    ----------
    name : str
        As on the command line.
    message_type : str
        ROS 2 name of the message.
    frame_id : str
        The driver's default frame.
    dtype : dtype
        Type of one point, padding included.
    pack : callable
        Sweep, dtype -> PackedCloud.
    """

    name: str
    message_type: str
    frame_id: str
    dtype: np.dtype[np.void]
    pack: Callable[[Sweep, np.dtype[np.void]], PackedCloud]


def _dtype(fields: _Fields, step: int) -> np.dtype[np.void]:
    names, formats, offsets = (list(column) for column in zip(*fields, strict=True))
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})


def _fill(dtype: np.dtype[np.void], xyz: NDArray[np.float32], **columns: object) -> NDArray[np.void]:
    points = np.zeros(len(xyz), dtype)
    points["x"], points["y"], points["z"] = xyz.T
    for name, values in columns.items():
        points[name] = values
    return points


def _ouster(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """Organised, top row first, lost returns as NaN; ``t`` counts from the header's stamp, the sweep's start."""
    rows, columns = sweep.ranges.shape
    points = np.zeros((rows, columns), dtype)
    lost = sweep.ranges == 0.0
    for i, name in enumerate("xyz"):
        points[name] = np.where(lost, _NAN, sweep.points[..., i])
    points["intensity"] = sweep.intensity
    points["t"] = sweep.offsets_ns
    points["reflectivity"] = sweep.intensity
    points["ring"] = np.arange(rows)[:, None]
    points["range"] = np.round(1000.0 * sweep.ranges)
    return PackedCloud(stamp_ns=sweep.stamp_ns, height=rows, width=columns, points=points, is_dense=False)


@dataclass(frozen=True, slots=True)
class _Fired:
    """The sweep's points in the order in which they were fired, lowest beam first."""

    xyz: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.int64]
    offsets_ns: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(cls, sweep: Sweep, *, lost: bool = False) -> _Fired:
        """``lost`` keeps the returns that were lost, as zeros."""
        rows, columns = sweep.ranges.shape
        keep = slice(None) if lost else np.flatnonzero(sweep.ranges[::-1].T.ravel() > 0.0)
        return cls(
            sweep.points[::-1].transpose(1, 0, 2).reshape(-1, 3)[keep],
            sweep.intensity[::-1].T.ravel()[keep],
            np.tile(np.arange(rows), columns)[keep],
            np.repeat(sweep.offsets_ns.astype(np.int64), rows)[keep],
        )


def _flatten(stamp_ns: int, points: NDArray[np.void], *, is_dense: bool) -> PackedCloud:
    return PackedCloud(stamp_ns=stamp_ns, height=1, width=len(points), points=points, is_dense=is_dense)


def _velodyne(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """``time`` in seconds from the header's stamp, the first packet's (``timestamp_first_packet: true``)."""
    fired = _Fired.of(sweep)
    time = fired.offsets_ns * 1e-9
    points = _fill(dtype, fired.xyz, intensity=fired.intensity, ring=fired.ring, time=time)
    return _flatten(sweep.stamp_ns, points, is_dense=True)


def _velodyne_negative(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """Do as the driver does by default: the header has the last packet's stamp, so that ``time`` is not positive."""
    fired = _Fired.of(sweep)
    last = int(sweep.offsets_ns[-1])
    time = (fired.offsets_ns - last) * 1e-9
    points = _fill(dtype, fired.xyz, intensity=fired.intensity, ring=fired.ring, time=time)
    return _flatten(sweep.stamp_ns + last, points, is_dense=True)


def _robosense(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """``timestamp`` in absolute seconds; one message row a firing, lost returns as NaN, the last point's header stamp.

    These are the driver's defaults: ``ros_send_by_rows``, ``dense_points`` and ``ts_first_point`` all false.
    """
    fired = _Fired.of(sweep, lost=True)
    timestamp = (sweep.stamp_ns + fired.offsets_ns) * 1e-9
    xyz = np.where(np.any(fired.xyz != 0.0, axis=1, keepdims=True), fired.xyz, _NAN)
    points = _fill(dtype, xyz, intensity=fired.intensity, ring=fired.ring, timestamp=timestamp)
    rows, columns = sweep.ranges.shape
    stamp_ns = sweep.stamp_ns + int(sweep.offsets_ns[-1])
    return PackedCloud(stamp_ns=stamp_ns, height=columns, width=rows, points=points, is_dense=False)


def _hesai(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """``timestamp`` in seconds since the epoch, as a double (good to 0.24 us); lost returns are left out."""
    fired = _Fired.of(sweep)
    timestamp = (sweep.stamp_ns + fired.offsets_ns) * 1e-9
    points = _fill(dtype, fired.xyz, intensity=fired.intensity, ring=fired.ring, timestamp=timestamp)
    return _flatten(sweep.stamp_ns, points, is_dense=False)


def _livox_custom(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """``offset_time`` in nanoseconds from the message's ``timebase``; lost returns are zeros."""
    fired = _Fired.of(sweep, lost=True)
    columns = {"offset_time": fired.offsets_ns, "reflectivity": fired.intensity, "tag": 0x10, "line": fired.ring}
    return _flatten(sweep.stamp_ns, _fill(dtype, fired.xyz, **columns), is_dense=True)


def _livox_pointcloud2(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    """``timestamp`` in nanoseconds since the epoch, as a double (good to 0.26 us); lost returns are zeros."""
    fired = _Fired.of(sweep, lost=True)
    timestamp = (sweep.stamp_ns + fired.offsets_ns).astype(np.float64)
    columns = {"intensity": fired.intensity, "tag": 0x10, "line": fired.ring, "timestamp": timestamp}
    return _flatten(sweep.stamp_ns, _fill(dtype, fired.xyz, **columns), is_dense=True)


def _no_time(sweep: Sweep, dtype: np.dtype[np.void]) -> PackedCloud:
    fired = _Fired.of(sweep)
    return _flatten(sweep.stamp_ns, _fill(dtype, fired.xyz, intensity=fired.intensity), is_dense=True)


_CLOUD = "sensor_msgs/msg/PointCloud2"
_XYZI: _Fields = [*_XYZ, ("intensity", "<f4", 12)]
_VELODYNE = _dtype([*_XYZI, ("ring", "<u2", 16), ("time", "<f4", 18)], 22)
_ABSOLUTE = _dtype([*_XYZI, ("ring", "<u2", 16), ("timestamp", "<f8", 18)], 26)
_OUSTER = _dtype(
    [
        *_XYZ,
        ("intensity", "<f4", 16),
        ("t", "<u4", 20),
        ("reflectivity", "<u2", 24),
        ("ring", "<u2", 26),
        ("ambient", "<u2", 28),
        ("range", "<u4", 32),
    ],
    48,
)
_LIVOX_POINT = _dtype(
    [
        ("offset_time", "<u4", 0),
        ("x", "<f4", 4),
        ("y", "<f4", 8),
        ("z", "<f4", 12),
        ("reflectivity", "u1", 16),
        ("tag", "u1", 17),
        ("line", "u1", 18),
    ],
    20,
)
_LIVOX_CLOUD = _dtype([*_XYZI, ("tag", "u1", 16), ("line", "u1", 17), ("timestamp", "<f8", 18)], 26)

LAYOUTS: MappingProxyType[str, SimulatedLayout] = MappingProxyType(
    {
        name: SimulatedLayout(name=name, message_type=kind, frame_id=frame, dtype=dtype, pack=pack)
        for name, kind, frame, dtype, pack in (
            ("ouster", _CLOUD, "os_lidar", _OUSTER, _ouster),
            ("velodyne", _CLOUD, "velodyne", _VELODYNE, _velodyne),
            ("velodyne-negative", _CLOUD, "velodyne", _VELODYNE, _velodyne_negative),
            ("hesai", _CLOUD, "hesai_lidar", _ABSOLUTE, _hesai),
            ("robosense", _CLOUD, "rslidar", _ABSOLUTE, _robosense),
            ("livox-custom", "livox_ros_driver2/msg/CustomMsg", "livox_frame", _LIVOX_POINT, _livox_custom),
            ("livox-custom-ros1name", "livox_ros_driver/msg/CustomMsg", "livox_frame", _LIVOX_POINT, _livox_custom),
            ("livox-pointcloud2", _CLOUD, "livox_frame", _LIVOX_CLOUD, _livox_pointcloud2),
            ("no-time", _CLOUD, "lidar", _dtype(_XYZI, 16), _no_time),
        )
    }
)


def find_layout(name: str) -> SimulatedLayout:
    """Return a layout by name, or raise `ConfigError` with the names there are."""
    if name not in LAYOUTS:
        raise ConfigError(f"layout '{name}' is unknown; there are {', '.join(LAYOUTS)}{closest(name, LAYOUTS)}")
    return LAYOUTS[name]
