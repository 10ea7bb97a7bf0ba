"""Small recordings of any container and layout, written with rosbags, for the readers' tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

CLOUD, IMU, FIX = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
TF = "tf2_msgs/msg/TFMessage"
T0 = 1_700_000_000_000_000_000
PERIOD = 100_000_000
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
CUSTOM = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n"
)
LIVOX_PACKAGES = ("livox_ros_driver", "livox_ros_driver2", "livox_interfaces")


def typestore(ros: int) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in store.types:
        store.register(get_types_from_msg(TF_DEFINITION, TF))
    for package in LIVOX_PACKAGES:
        store.register(get_types_from_msg(POINT, f"{package}/msg/CustomPoint"))
        store.register(get_types_from_msg(CUSTOM, f"{package}/msg/CustomMsg"))
    return store


STORES = {1: typestore(1), 2: typestore(2)}


def header(store: Any, stamp_ns: int, frame: str) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return (
        kind(seq=7, stamp=time, frame_id=frame)
        if "seq" in kind.__dataclass_fields__
        else kind(stamp=time, frame_id=frame)
    )


def point_dtype(fields: Sequence[tuple[str, str, int]], step: int) -> np.dtype:
    names, formats, offsets = (list(c) for c in zip(*fields, strict=True))
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})


def cloud_message(store: Any, points: np.ndarray, stamp_ns: int, frame: str = "lidar", row_padding: int = 0) -> Any:
    """A PointCloud2 of a structured array (N,) or (H, W); a big-endian dtype makes a big-endian message."""
    rows = points if points.ndim == 2 else points[None]
    big = any(dtype.str[0] == ">" for dtype, *_ in points.dtype.fields.values())
    field_type = store.types["sensor_msgs/msg/PointField"]
    fields = [
        field_type(name=name, offset=offset, datatype=DATATYPES[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in points.dtype.fields.items()
    ]
    row_step = points.dtype.itemsize * rows.shape[1] + row_padding
    data = b"".join(row.tobytes() + b"\xaa" * row_padding for row in rows)
    return store.types[CLOUD](
        header=header(store, stamp_ns, frame),
        height=rows.shape[0],
        width=rows.shape[1],
        fields=fields,
        is_bigendian=big,
        point_step=points.dtype.itemsize,
        row_step=row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=False,
    )


def livox_message(store: Any, package: str, points: np.ndarray, stamp_ns: int, frame: str = "livox_frame") -> Any:
    point = store.types[f"{package}/msg/CustomPoint"]
    return store.types[f"{package}/msg/CustomMsg"](
        header=header(store, stamp_ns, frame),
        timebase=stamp_ns,
        point_num=len(points),
        lidar_id=1,
        rsvd=np.zeros(3, np.uint8),
        points=[point(**{name: row[name].item() for name in points.dtype.names}) for row in points],
    )


def imu_message(store: Any, stamp_ns: int, gyro: Sequence[float], accel: Sequence[float], frame: str = "imu") -> Any:
    vector, quaternion = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Quaternion"]
    absent = np.zeros(9)
    absent[0] = -1.0
    return store.types[IMU](
        header=header(store, stamp_ns, frame),
        orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=absent,
        angular_velocity=vector(*(float(v) for v in gyro)),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*(float(v) for v in accel)),
        linear_acceleration_covariance=np.zeros(9),
    )


def fix_message(store: Any, stamp_ns: int, latitude: float = 48.1, status: int = 0) -> Any:
    return store.types[FIX](
        header=header(store, stamp_ns, "gnss"),
        status=store.types["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
        latitude=latitude,
        longitude=11.6,
        altitude=520.0,
        position_covariance=np.diag([1.0, 2.0, 3.0]).ravel(),
        position_covariance_type=2,
    )


def tf_message(store: Any, edges: Sequence[tuple[str, str, Sequence[float], Sequence[float]]]) -> Any:
    vector, quaternion = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Quaternion"]
    transform, stamped = (store.types[f"geometry_msgs/msg/Transform{s}"] for s in ("", "Stamped"))
    return store.types[TF](
        transforms=[
            stamped(
                header=header(store, T0, parent),
                child_frame_id=child,
                transform=transform(translation=vector(*translation), rotation=quaternion(*xyzw)),
            )
            for parent, child, translation, xyzw in edges
        ]
    )


@dataclass
class Bag:
    """Messages to write: (topic, type, received_ns, make), where ``make(store)`` builds the message."""

    messages: list[tuple[str, str, int, Callable[[Any], Any]]] = field(default_factory=list)

    def add(self, topic: str, kind: str, received_ns: int, make: Callable[[Any], Any]) -> Bag:
        self.messages.append((topic, kind, received_ns, make))
        return self

    def cloud(
        self, points: np.ndarray, stamp_ns: int, received_ns: int | None = None, topic: str = "/points", **kw: Any
    ) -> Bag:
        at = stamp_ns + PERIOD if received_ns is None else received_ns
        return self.add(topic, CLOUD, at, lambda store: cloud_message(store, points, stamp_ns, **kw))

    def imu(
        self,
        stamp_ns: int,
        gyro: Sequence[float] = (0.001, 0.0, 0.0),
        accel: Sequence[float] = (0.0, 0.0, 9.81),
        received_ns: int | None = None,
        topic: str = "/imu",
        **kw: Any,
    ) -> Bag:
        at = stamp_ns if received_ns is None else received_ns
        return self.add(topic, IMU, at, lambda store: imu_message(store, stamp_ns, gyro, accel, **kw))

    def tf(self, *edges: Any, received_ns: int = T0, topic: str = "/tf_static") -> Bag:
        return self.add(topic, TF, received_ns, lambda store: tf_message(store, edges))

    def livox(
        self, points: np.ndarray, stamp_ns: int, package: str = "livox_ros_driver2", topic: str = "/livox/lidar"
    ) -> Bag:
        kind = f"{package}/msg/CustomMsg"
        return self.add(topic, kind, stamp_ns + PERIOD, lambda store: livox_message(store, package, points, stamp_ns))

    def ros2(self, path: Path, *, storage: str = "mcap", compression: str = "") -> Path:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        with writer:
            self._write(writer, STORES[2], lambda message, kind: STORES[2].serialize_cdr(message, kind))
        return path

    def mcap(self, path: Path) -> Path:
        """A bare MCAP file without the folder and metadata.yaml of a bag."""
        folder = self.ros2(path.parent / f"{path.stem}_folder")
        next(folder.glob("*.mcap")).rename(path)
        (folder / "metadata.yaml").unlink()
        folder.rmdir()
        return path

    def ros1(self, path: Path, compression: str = "") -> Path:
        writer = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        with writer:
            self._write(writer, STORES[1], lambda message, kind: STORES[1].serialize_ros1(message, kind))
        return path

    def _write(self, writer: Any, store: Any, serialize: Callable[[Any, str], Any]) -> None:
        connections: dict[str, Any] = {}
        for topic, kind, received_ns, make in sorted(self.messages, key=lambda m: m[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], received_ns, bytes(serialize(make(store), kind)))


VELODYNE = point_dtype(
    [
        ("x", "<f4", 0),
        ("y", "<f4", 4),
        ("z", "<f4", 8),
        ("intensity", "<f4", 12),
        ("ring", "<u2", 16),
        ("time", "<f4", 18),
    ],
    22,
)


def sweep(dtype: np.dtype, n: int = 400, seed: int = 0) -> np.ndarray:
    """Points around the sensor in the order of their azimuth, with no time yet."""
    rng = np.random.default_rng(seed)
    points = np.zeros(n, dtype)
    azimuth = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    distance = rng.uniform(2.0, 30.0, n)
    points["x"], points["y"], points["z"] = distance * np.cos(azimuth), distance * np.sin(azimuth), rng.normal(size=n)
    return points


def drive(scans: int = 8, *, imu_rate: int = 100, times: str = "start", tf: bool = True) -> Bag:
    """A short recording: velodyne clouds at 10 Hz, an IMU, tf_static."""
    bag = Bag()
    if tf:
        bag.tf(
            ("base", "imu", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0)),
            ("base", "lidar", (0.0, 0.3, 1.0), (0.0, 0.0, 1.0, 0.0)),
        )
    for k in range(scans):
        points = sweep(VELODYNE, seed=k)
        points["time"] = np.linspace(0.0, 0.0998, len(points))
        points["intensity"] = np.arange(len(points)) % 255
        stamp = T0 + k * PERIOD
        if times == "negative":
            points["time"] -= points["time"][-1]
            stamp += 99_800_000
        bag.cloud(points, stamp, received_ns=T0 + (k + 1) * PERIOD)
    for k in range(scans * imu_rate // 10):
        bag.imu(T0 + k * (10**9 // imu_rate))
    return bag
