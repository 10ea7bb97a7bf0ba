"""Decoders from a message's bytes to raw records, for the CDR (ROS 2) and the ROS 1 serialisation.

A generic deserialiser builds an object a field; these read only what the estimation uses and leave a cloud where it
is: its columns are strided views of the payload. Layouts: OMG CDR 1.0 (primitives aligned to their size, counted
from the byte after the 4-byte encapsulation header) and the ROS 1 serialisation (no alignment, a sequence number
first in the header).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import DataError
from heliograph.io.raw import RawCloud, RawFix, RawImu, RawMessage, RawSpeed, RawTransform

__all__ = ["DECODERS", "KINDS", "Decoder", "point_columns"]

Decoder = Callable[[str, int, memoryview, str], list[RawMessage]]
"""Topic, time received [ns], payload, encoding -> raw records (one, or one an edge for tf)."""

MAX_TRANSFORM_M = 1e9  # [m]
MAX_VARIANCE = 1e4  # of a speed; drivers write 1e6 and more for an axis that is not measured [m^2/s^2]
_ORDER_SAMPLES = 100  # points that tell the byte order
POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
LIVOX_COLUMNS = {
    "offset_time": ("u4", 0),
    "x": ("f4", 4),
    "y": ("f4", 8),
    "z": ("f4", 12),
    "reflectivity": ("u1", 16),
    "tag": ("u1", 17),
    "line": ("u1", 18),
}


@lru_cache(maxsize=64)
def _struct(layout: str) -> struct.Struct:
    return struct.Struct(layout)


class _Cursor:
    """Reads primitives from a payload, aligned as its encoding asks."""

    __slots__ = ("at", "base", "cdr", "data", "order")

    def __init__(self, data: memoryview, encoding: str) -> None:
        self.data = data
        self.cdr = encoding == "cdr"
        self.base = 4 if self.cdr else 0
        self.order = ">" if self.cdr and data[1] & 1 == 0 else "<"
        self.at = self.base

    def take(self, layout: str, align: int) -> tuple[int | float, ...]:
        """Read equal-sized primitives of size ``align``."""
        if self.cdr:
            self.at += -(self.at - self.base) % align
        reader = _struct(self.order + layout)
        values = reader.unpack_from(self.data, self.at)
        self.at += reader.size
        return values

    def integer(self, code: str, align: int) -> int:
        return int(self.take(code, align)[0])

    def text(self) -> str:
        size = self.integer("I", 4)
        value = bytes(self.data[self.at : self.at + size])
        self.at += size
        return value.rstrip(b"\0").decode(errors="replace")

    def header(self) -> tuple[int, str]:
        """Read a ``std_msgs/Header``; its stamp [ns] and frame."""
        if self.cdr:
            seconds, nanoseconds = self.take("iI", 4)
        else:
            _, seconds, nanoseconds = self.take("III", 4)
        return int(seconds) * 1_000_000_000 + int(nanoseconds), self.text()


def point_columns(
    data: memoryview,
    fields: tuple[tuple[str, int, int, int], ...],
    order: str,
    shape: tuple[int, int],
    steps: tuple[int, int],
) -> dict[str, NDArray[np.generic]]:
    """Return the columns of a ``PointCloud2`` as views of its data.

    Parameters
    ----------
    data : memoryview
        The message's ``data``.
    fields : tuple of (name, offset, datatype, count)
        As in the message; of a field with several values only the first is kept, unnamed padding is left out.
    order : str
        ``"<"`` or ``">"``.
    shape : (height, width)
        A cloud of one row gives columns of shape (width,), else (height, width).
    steps : (row_step, point_step)
        Bytes from one row, one point to the next.

    Raises
    ------
    DataError
        A field reaches beyond its point, or the data are shorter than the header says.
    """
    height, width = shape
    row_step, point_step = steps
    columns: dict[str, NDArray[np.generic]] = {}
    for name, offset, datatype, count in fields:
        kind = POINT_TYPES.get(datatype)
        if kind is None or not name or count == 0:
            continue
        dtype = np.dtype(order + kind)
        if offset + dtype.itemsize > point_step:
            raise DataError(f"field '{name}' ends at byte {offset + dtype.itemsize} of a {point_step}-byte point")
        if height * width == 0:
            columns[name] = np.empty(0, dtype)
            continue
        # Held against the data in whole numbers: NumPy's own check of strides overflows where a product passes 2^63.
        if (height - 1) * row_step + (width - 1) * point_step + offset + dtype.itemsize > len(data):
            raise DataError(f"{len(data)} bytes for {height} x {width} points of {point_step} bytes")
        size, strides = ((width,), (point_step,)) if height == 1 else ((height, width), (row_step, point_step))
        columns[name] = np.ndarray(size, dtype, buffer=data, offset=offset, strides=strides)
    return columns


def _decode_cloud(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``sensor_msgs/PointCloud2``."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    height, width, number = (int(v) for v in cursor.take("III", 4))
    fields = []
    for _ in range(number):
        name = cursor.text()
        offset = cursor.integer("I", 4)
        datatype = cursor.integer("B", 1)
        fields.append((name, offset, datatype, cursor.integer("I", 4)))
    big = cursor.integer("B", 1)
    point_step, row_step, size = (int(v) for v in cursor.take("III", 4))
    data = payload[cursor.at : cursor.at + size]
    # Some drivers leave row_step unset; a sane one covers its points.
    row_step = row_step if row_step >= width * point_step else width * point_step
    shape, steps = (height, width), (row_step, point_step)
    columns = point_columns(data, tuple(fields), ">" if big else "<", shape, steps)
    swapped = _contradicts_order(columns)
    if swapped:
        columns = point_columns(data, tuple(fields), "<" if big else ">", shape, steps)
    return [
        RawCloud(
            topic=topic, received_ns=received_ns, stamp_ns=stamp_ns, frame_id=frame, columns=columns, swapped=swapped
        )
    ]


@np.errstate(invalid="ignore", over="ignore")
def _contradicts_order(columns: dict[str, NDArray[np.generic]]) -> bool:
    """Tell whether ``is_bigendian`` lies: coordinates are lengths in one order of bytes and noise in the other."""
    axes = [columns[axis].reshape(-1) for axis in "xyz" if axis in columns]
    if len(axes) < 3 or any(axis.dtype.kind != "f" for axis in axes) or axes[0].size == 0:
        return False
    step = max(1, axes[0].size // _ORDER_SAMPLES)
    sample = [np.ascontiguousarray(axis[::step]) for axis in axes]
    here, there = _lengths(sample), _lengths([axis.view(axis.dtype.newbyteorder()) for axis in sample])
    return here < 0.05 * len(sample[0]) and there > 0.3 * len(sample[0])


def _lengths(axes: list[NDArray[np.generic]]) -> int:
    """Count the points whose three coordinates are all lengths that a LiDAR can see, and not all zero."""
    size = np.abs(np.stack([axis.astype(np.float64) for axis in axes]))
    seen = (size == 0.0) | ((size > 1e-5) & (size < 1e5))
    return int(np.count_nonzero(seen.all(axis=0) & size.any(axis=0)))


def _decode_livox(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``livox_ros_driver*/CustomMsg``: points of 19 bytes, aligned to 20 in CDR (the last one is not padded)."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    base_ns = cursor.integer("Q", 8)
    cursor.take("I", 4)  # point_num repeats the length of the sequence
    cursor.take("4B", 1)  # lidar_id, rsvd
    number = cursor.integer("I", 4)
    step = 20 if cursor.cdr else 19
    data = payload[cursor.at :]
    columns: dict[str, NDArray[np.generic]] = {}
    for name, (kind, offset) in LIVOX_COLUMNS.items():
        dtype = np.dtype(cursor.order + kind)
        if number * step > len(data) + 1:
            raise DataError(f"{len(data)} bytes for {number} Livox points of {step} bytes")
        columns[name] = (
            np.ndarray((number,), dtype, buffer=data, offset=offset, strides=(step,)) if number else np.empty(0, dtype)
        )
    cloud = RawCloud(
        topic=topic,
        received_ns=received_ns,
        stamp_ns=stamp_ns,
        frame_id=frame,
        columns=columns,
        layout="livox/CustomMsg",
        base_time_ns=base_ns,
    )
    return [cloud]


def _decode_imu(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``sensor_msgs/Imu``."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    v = cursor.take("37d", 8)  # orientation, its covariance, rate, its covariance, specific force, its covariance
    # An IMU without orientation says so with a first covariance of -1, or leaves the quaternion at zero.
    oriented = v[4] != -1.0 and abs(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3] - 1.0) < 0.1
    return [
        RawImu(
            topic=topic,
            received_ns=received_ns,
            stamp_ns=stamp_ns,
            frame_id=frame,
            gyro=v[13:16],  # type: ignore[arg-type]
            accel=v[25:28],  # type: ignore[arg-type]
            has_orientation=oriented,
        )
    ]


_SOLUTIONS = {
    0: "single",
    1: "sbas",
    2: "fixed",
}  # NavSatStatus; receivers with a carrier-phase fix report ground-based


def _decode_fix(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``sensor_msgs/NavSatFix``."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    status = cursor.integer("b", 1)
    cursor.take("H", 2)
    values = cursor.take("12d", 8)
    kind = cursor.integer("B", 1)
    covariance = np.array(values[3:], dtype=np.float64).reshape(3, 3) if kind != 0 else None
    return [
        RawFix(
            topic=topic,
            received_ns=received_ns,
            stamp_ns=stamp_ns,
            frame_id=frame,
            latitude_deg=float(values[0]),
            longitude_deg=float(values[1]),
            altitude=float(values[2]),
            covariance_enu=covariance,
            valid=status >= 0 and bool(np.isfinite(values[:3]).all()),
            solution=_SOLUTIONS.get(status, ""),
        )
    ]


def _decode_odometry(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``nav_msgs/Odometry``: the twist, which is in the child frame; of the pose only the position."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, _ = cursor.header()
    child = cursor.text()
    v = cursor.take("85d", 8)  # pose, its covariance, twist, its covariance
    return [_speed(topic, received_ns, stamp_ns, child, v[43:46], v[49:], position=v[:3])]


def _decode_twist(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``geometry_msgs/TwistStamped``."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    return [_speed(topic, received_ns, stamp_ns, frame, cursor.take("6d", 8)[:3])]


def _decode_sure_twist(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``geometry_msgs/TwistWithCovarianceStamped``."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    v = cursor.take("42d", 8)
    return [_speed(topic, received_ns, stamp_ns, frame, v[:3], v[6:])]


def _speed(
    topic: str,
    received_ns: int,
    stamp_ns: int,
    frame: str,
    v_body: tuple[float, ...],
    covariance: tuple[float, ...] = (0.0,) * 36,
    position: tuple[float, ...] | None = None,
) -> RawSpeed:
    variance = np.array([covariance[0], covariance[7], covariance[14]], dtype=np.float64)
    told = np.isfinite(variance) & (variance > 0.0) & (variance < MAX_VARIANCE)
    return RawSpeed(
        topic=topic,
        received_ns=received_ns,
        stamp_ns=stamp_ns,
        frame_id=frame.lstrip("/"),
        v_body=np.array(v_body, dtype=np.float64),
        sigma=np.sqrt(np.where(told, variance, 0.0)),
        position=None if position is None else np.array(position, dtype=np.float64),
    )


def _decode_joints(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``sensor_msgs/JointState``: how fast each joint turns."""
    cursor = _Cursor(payload, encoding)
    stamp_ns, frame = cursor.header()
    names = [cursor.text() for _ in range(cursor.integer("I", 4))]
    rates: tuple[float, ...] = ()
    for _ in ("position", "velocity"):
        count = cursor.integer("I", 4)
        rates = cursor.take(f"{count}d", 8) if count else ()
    if rates and len(rates) != len(names):
        raise DataError(f"{len(names)} joints with {len(rates)} velocities")
    return [
        RawSpeed(
            topic=topic,
            received_ns=received_ns,
            stamp_ns=stamp_ns,
            frame_id=frame.lstrip("/"),
            v_body=np.full(3, np.nan),
            sigma=np.zeros(3),
            joints=dict(zip(names, rates, strict=False)),
        )
    ]


def _decode_tf(topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
    """``tf2_msgs/TFMessage``."""
    cursor = _Cursor(payload, encoding)
    found: list[RawMessage] = []
    for _ in range(cursor.integer("I", 4)):
        _, parent = cursor.header()
        child = cursor.text()
        values = np.array(cursor.take("7d", 8), dtype=np.float64)
        if not (np.abs(values) < MAX_TRANSFORM_M).all():
            raise DataError(f"the transform from '{parent}' to '{child}' is not finite")
        T = np.eye(4)
        T[:3, :3] = quaternion_matrix(values[3:])
        T[:3, 3] = values[:3]
        found.append(
            RawTransform(
                topic=topic,
                received_ns=received_ns,
                parent=parent.lstrip("/"),
                child=child.lstrip("/"),
                T_parent_child=T,
                static="static" in topic,
            )
        )
    return found


def quaternion_matrix(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a quaternion, normalised; the identity for a zero quaternion."""
    norm = float(np.linalg.norm(xyzw))
    if not norm > 0.0:
        return np.eye(3)
    x, y, z, w = xyzw / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


DECODERS: dict[str, Decoder] = {
    "sensor_msgs/msg/PointCloud2": _decode_cloud,
    "livox_ros_driver/msg/CustomMsg": _decode_livox,
    "livox_ros_driver2/msg/CustomMsg": _decode_livox,
    "livox_interfaces/msg/CustomMsg": _decode_livox,
    "sensor_msgs/msg/Imu": _decode_imu,
    "sensor_msgs/msg/NavSatFix": _decode_fix,
    "nav_msgs/msg/Odometry": _decode_odometry,
    "geometry_msgs/msg/TwistStamped": _decode_twist,
    "geometry_msgs/msg/TwistWithCovarianceStamped": _decode_sure_twist,
    "sensor_msgs/msg/JointState": _decode_joints,
    "tf2_msgs/msg/TFMessage": _decode_tf,
    "tf/msg/tfMessage": _decode_tf,
}
"""Message type -> decoder."""

KINDS: dict[str, str] = {
    "sensor_msgs/msg/PointCloud2": "lidar",
    "livox_ros_driver/msg/CustomMsg": "lidar",
    "livox_ros_driver2/msg/CustomMsg": "lidar",
    "livox_interfaces/msg/CustomMsg": "lidar",
    "sensor_msgs/msg/Imu": "imu",
    "sensor_msgs/msg/NavSatFix": "gnss",
    "nav_msgs/msg/Odometry": "speed",
    "geometry_msgs/msg/TwistStamped": "speed",
    "geometry_msgs/msg/TwistWithCovarianceStamped": "speed",
    "sensor_msgs/msg/JointState": "speed",
    "tf2_msgs/msg/TFMessage": "tf",
    "tf/msg/tfMessage": "tf",
}
"""Message type -> `TopicInfo.kind`."""
