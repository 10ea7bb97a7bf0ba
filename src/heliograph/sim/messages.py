"""Simulated records as serialised ROS 2 messages."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from heliograph.data import GnssFix
from heliograph.lie import so3
from heliograph.sim.layouts import PackedCloud, SimulatedLayout

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg

__all__ = ["Messages"]

_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}  # sensor_msgs/PointField
_SOLUTIONS = {"sbas": 1, "float": 1, "fixed": 2}  # NavSatStatus: no finer states; 0 is a single fix
_LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
_LIVOX_MESSAGE = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n"
)


def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for package in ("livox_ros_driver", "livox_ros_driver2"):
        store.register(get_types_from_msg(_LIVOX_POINT, f"{package}/msg/CustomPoint"))
        store.register(get_types_from_msg(_LIVOX_MESSAGE, f"{package}/msg/CustomMsg"))
    return store


class Messages:
    """Serialises records; holds the message types."""

    def __init__(self) -> None:
        self.store = _typestore()
        self._types = self.store.types

    def _header(self, stamp_ns: int, frame_id: str) -> Msg:
        stamp = self._types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def cloud(self, layout: SimulatedLayout, cloud: PackedCloud) -> bytes | memoryview:
        """Return a PointCloud2 or a Livox CustomMsg."""
        if layout.message_type.endswith("/CustomMsg"):
            return _livox(layout.frame_id, cloud)
        dtype_fields = layout.dtype.fields
        assert dtype_fields is not None
        field = self._types["sensor_msgs/msg/PointField"]
        fields = [
            field(name=name, offset=offset, datatype=_DATATYPES[kind.str[1:]], count=1)
            for name, (kind, offset, *_) in dtype_fields.items()
        ]
        message = self._types["sensor_msgs/msg/PointCloud2"](
            header=self._header(cloud.stamp_ns, layout.frame_id),
            height=cloud.height,
            width=cloud.width,
            fields=fields,
            is_bigendian=False,
            point_step=layout.dtype.itemsize,
            row_step=layout.dtype.itemsize * cloud.width,
            data=np.ascontiguousarray(cloud.points).reshape(-1).view(np.uint8),
            is_dense=cloud.is_dense,
        )
        return self.store.serialize_cdr(message, layout.message_type)

    def imu(
        self, stamps_ns: NDArray[np.int64], gyro: NDArray[np.float64], accel: NDArray[np.float64], frame_id: str
    ) -> Iterator[bytes | memoryview]:
        """Yield one Imu message a sample; its orientation is marked as absent (first covariance entry -1)."""
        vector, quaternion = self._types["geometry_msgs/msg/Vector3"], self._types["geometry_msgs/msg/Quaternion"]
        identity = quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        absent, unknown = np.zeros(9), np.zeros(9)
        absent[0] = -1.0
        for stamp, w, f in zip(stamps_ns.tolist(), gyro.tolist(), accel.tolist(), strict=True):
            message = self._types["sensor_msgs/msg/Imu"](
                header=self._header(stamp, frame_id),
                orientation=identity,
                orientation_covariance=absent,
                angular_velocity=vector(x=w[0], y=w[1], z=w[2]),
                angular_velocity_covariance=unknown,
                linear_acceleration=vector(x=f[0], y=f[1], z=f[2]),
                linear_acceleration_covariance=unknown,
            )
            yield self.store.serialize_cdr(message, "sensor_msgs/msg/Imu")

    def fix(self, fix: GnssFix) -> bytes | memoryview:
        """Return a NavSatFix; without a fix its position is NaN."""
        nan = float("nan")
        covariance = np.zeros(9) if fix.covariance_enu is None else fix.covariance_enu.ravel()
        message = self._types["sensor_msgs/msg/NavSatFix"](
            header=self._header(fix.stamp_ns, fix.frame_id),
            status=self._types["sensor_msgs/msg/NavSatStatus"](
                status=_SOLUTIONS.get(fix.solution, 0) if fix.valid else -1, service=1
            ),
            latitude=fix.latitude_deg if fix.valid else nan,
            longitude=fix.longitude_deg if fix.valid else nan,
            altitude=fix.altitude if fix.valid else nan,
            position_covariance=covariance,
            position_covariance_type=2,
        )
        return self.store.serialize_cdr(message, "sensor_msgs/msg/NavSatFix")

    def odometry(self, stamp_ns: int, v_body: NDArray[np.float64], frame: str) -> bytes | memoryview:
        """Return an Odometry whose twist is a speed (3,); what is not measured is zero, as drivers write it."""
        point, quaternion = self._types["geometry_msgs/msg/Point"], self._types["geometry_msgs/msg/Quaternion"]
        vector, unknown = self._types["geometry_msgs/msg/Vector3"], np.zeros(36)
        x, y, z = np.nan_to_num(v_body).tolist()
        message = self._types["nav_msgs/msg/Odometry"](
            header=self._header(stamp_ns, "wheel_odom"),
            child_frame_id=frame,
            pose=self._types["geometry_msgs/msg/PoseWithCovariance"](
                pose=self._types["geometry_msgs/msg/Pose"](
                    position=point(x=0.0, y=0.0, z=0.0), orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
                ),
                covariance=unknown,
            ),
            twist=self._types["geometry_msgs/msg/TwistWithCovariance"](
                twist=self._types["geometry_msgs/msg/Twist"](
                    linear=vector(x=x, y=y, z=z), angular=vector(x=0.0, y=0.0, z=0.0)
                ),
                covariance=unknown,
            ),
        )
        return self.store.serialize_cdr(message, "nav_msgs/msg/Odometry")

    def transforms(self, stamp_ns: int, edges: Sequence[tuple[str, str, NDArray[np.float64]]]) -> bytes | memoryview:
        """Return a TFMessage of (parent, child, T_parent_child)."""
        vector, quaternion = self._types["geometry_msgs/msg/Vector3"], self._types["geometry_msgs/msg/Quaternion"]
        transform, stamped = (self._types[f"geometry_msgs/msg/Transform{s}"] for s in ("", "Stamped"))
        messages = []
        for parent, child, T in edges:
            x, y, z, w = so3.to_quaternion(T[:3, :3]).tolist()
            t = T[:3, 3].tolist()
            placed = transform(translation=vector(x=t[0], y=t[1], z=t[2]), rotation=quaternion(x=x, y=y, z=z, w=w))
            messages.append(stamped(header=self._header(stamp_ns, parent), child_frame_id=child, transform=placed))
        return self.store.serialize_cdr(
            self._types["tf2_msgs/msg/TFMessage"](transforms=messages), "tf2_msgs/msg/TFMessage"
        )


def _livox(frame_id: str, cloud: PackedCloud) -> bytes:
    """CDR of a CustomMsg: 65 536 point objects would cost a second, the packed array already has CDR's own layout."""
    name = frame_id.encode() + b"\0"
    body = struct.pack("<iII", cloud.stamp_ns // 10**9, cloud.stamp_ns % 10**9, len(name)) + name
    body += bytes(-len(body) % 8)
    count = len(cloud.points)
    body += struct.pack("<QIB3xI", cloud.stamp_ns, count, 192, count)
    # CDR aligns a point to 4 bytes, so that all but the last are followed by one byte of padding.
    return b"\x00\x01\x00\x00" + body + cloud.points.tobytes()[:-1]
