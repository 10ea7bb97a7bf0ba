"""Rewrites a simulated recording message by message, to make the recordings that go wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

POINTS, IMU = "/points", "/imu/data"
FLOAT64 = 8
Message = tuple[str, int, Any]


def rewrite(source: Path, target: Path, change: Callable[[str, int, Any], Iterable[Message]]) -> Path:
    """Copy a bag through ``change``: topic, time, message in; any number of them out."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}
    writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
    with AnyReader([source], default_typestore=store) as reader, writer:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            for topic, at, changed in change(connection.topic, time_ns, message):
                kind = changed.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], at, store.serialize_cdr(changed, kind))
    return target


def table(message: Any) -> np.ndarray:
    """Return a PointCloud2's points as a record array that can be written to."""
    kinds = {2: "u1", 4: "<u2", 6: "<u4", 7: "<f4", 8: "<f8"}
    dtype = np.dtype({
        "names": [field.name for field in message.fields],
        "formats": [kinds[field.datatype] for field in message.fields],
        "offsets": [field.offset for field in message.fields],
        "itemsize": message.point_step,
    })  # fmt: skip
    return np.frombuffer(message.data.tobytes(), dtype=dtype).copy()


def store_points(message: Any, points: np.ndarray) -> Any:
    """Put points back into a PointCloud2, as one row."""
    message.data = np.frombuffer(points.tobytes(), dtype=np.uint8)
    message.height, message.width = 1, len(points)
    message.row_step = message.point_step * len(points)
    message.is_dense = False
    return message


def on_points(edit: Callable[[Any], Any]) -> Callable[[str, int, Any], Iterable[Message]]:
    """Return a change of the clouds alone."""
    return lambda topic, at, message: [(topic, at, edit(message) if topic == POINTS else message)]


def on_imu(edit: Callable[[Any], Any]) -> Callable[[str, int, Any], Iterable[Message]]:
    """Return a change of the IMU samples alone."""
    return lambda topic, at, message: [(topic, at, edit(message) if topic == IMU else message)]


def without(*topics: str) -> Callable[[str, int, Any], Iterable[Message]]:
    """Return a change that leaves topics out."""
    return lambda topic, at, message: [] if topic in topics else [(topic, at, message)]


def twice(topic_twice: str, copy: str) -> Callable[[str, int, Any], Iterable[Message]]:
    """Return a change that gives one topic a twin."""

    def change(topic: str, at: int, message: Any) -> Iterable[Message]:
        yield topic, at, message
        if topic == topic_twice:
            yield copy, at, message

    return change


def imu_in_g(message: Any) -> Any:
    acceleration = message.linear_acceleration
    for axis in "xyz":
        setattr(acceleration, axis, getattr(acceleration, axis) / 9.80665)
    return message


def accel_negated(message: Any) -> Any:
    acceleration = message.linear_acceleration
    for axis in "xyz":
        setattr(acceleration, axis, -getattr(acceleration, axis))
    return message


def times_dropped(message: Any) -> Any:
    message.fields = [field for field in message.fields if field.name != "t"]
    return message


def times_labelled_seconds(message: Any) -> Any:
    """Give the points a field ``time`` of floats, which drivers fill with seconds, full of nanoseconds."""
    for field in message.fields:
        if field.name == "t":
            field.name, field.datatype = "time", 7
            points = table(message)
            integers = np.frombuffer(message.data.tobytes(), dtype=np.uint8).reshape(-1, message.point_step)
            offset = field.offset
            points["time"] = integers[:, offset : offset + 4].copy().view("<u4")[:, 0].astype(np.float32)
            height, width = message.height, message.width
            message = store_points(message, points)
            message.height, message.width, message.row_step = height, width, width * message.point_step
    return message


def nan_and_zero_points(message: Any) -> Any:
    points = table(message)
    for axis in "xyz":
        points[axis][::5] = np.nan
        points[axis][1::5] = 0.0
    return store_points(message, points)


class EveryFifthEmpty:
    """Empties 20 % of the scans."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, message: Any) -> Any:
        self.count += 1
        return store_points(message, table(message)[:0]) if self.count % 5 == 0 else message


class Gap:
    """Leaves out everything between two times since the first message."""

    def __init__(self, start_s: float, end_s: float) -> None:
        self.start_s, self.end_s, self.first = start_s, end_s, None

    def __call__(self, topic: str, at: int, message: Any) -> Iterable[Message]:
        self.first = at if self.first is None else self.first
        inside = self.start_s < (at - self.first) * 1e-9 < self.end_s
        return [] if inside and topic in (POINTS, IMU) else [(topic, at, message)]


class SwappedStamps:
    """Gives every tenth pair of scans each other's header stamp, so that time runs back."""

    def __init__(self) -> None:
        self.count, self.held = 0, None

    def __call__(self, message: Any) -> Any:
        self.count += 1
        stamp = message.header.stamp
        if self.count % 10 == 9:
            self.held = (stamp.sec, stamp.nanosec)
            stamp.nanosec += 150_000_000
            if stamp.nanosec >= 1_000_000_000:
                stamp.sec, stamp.nanosec = stamp.sec + 1, stamp.nanosec - 1_000_000_000
        return message
