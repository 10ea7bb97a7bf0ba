"""Ouster packets to points and inertial samples, through the vendor's ``ouster-sdk``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError, MissingDependencyError
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.io.raw import RawCloud, RawImu, RawMessage
from heliograph.lie import se3

__all__ = ["OusterDecoder", "is_ouster_metadata", "ouster_core"]

INSTALL = "pip install 'heliograph[ouster]' && pip install --no-deps 'ouster-sdk>=1.0'"
LIDAR_FRAME, IMU_FRAME = "os_sensor", "os_imu"
_MILLIMETRE = 1e-3
_VALID_COLUMN = 1


def ouster_core() -> Any:  # noqa: ANN401 - an optional package without types
    """Return the module ``ouster.sdk.core``, or raise `MissingDependencyError` with the install command."""
    try:
        from ouster.sdk import core
    except ImportError as error:
        message = f"Ouster packets need ouster-sdk: {INSTALL} ({error})"
        raise MissingDependencyError(message) from error
    return core


def is_ouster_metadata(path: Path) -> bool:
    """Tell whether a JSON file looks like the metadata of an Ouster sensor."""
    try:
        content = json.loads(plain_file(path, SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and bool({"beam_altitude_angles", "beam_intrinsics"} & set(content))


class OusterDecoder:
    """Collects one sensor's packets into sweeps.

    Parameters
    ----------
    metadata : str
        The sensor's metadata, JSON.
    source : Path or str
        Where it came from, for messages.
    lidar_topic, imu_topic : str
        Topics to give the messages.

    Raises
    ------
    MissingDependencyError
        ouster-sdk is not installed.
    FormatError
        The metadata cannot be understood.

    Notes
    -----
    Points are in the vendor's sensor frame, at the time of their column, in the sensor's clock, which the inertial
    samples share. The SDK gives specific force in m/s^2 and angular rate in rad/s (`ImuPacket.accel`,
    `ImuPacket.gyro`). Only the first return is kept.
    """

    def __init__(self, metadata: str, source: Path | str, lidar_topic: str, imu_topic: str) -> None:
        self._core = ouster_core()
        try:
            self.info = self._core.SensorInfo(metadata)
            self.format = self._core.PacketFormat(self.info)
            self._table = self._core.XYZLutFloat(self.info, False)
            self._batcher = self._core.FrameBatcher(self.info)
        except (RuntimeError, ValueError, TypeError) as error:
            raise FormatError(source, f"is not metadata that ouster-sdk understands: {error}") from error
        self._lidar_topic, self._imu_topic = lidar_topic, imu_topic
        self._frame: Any = None
        self._received_ns = 0

    @property
    def packets_per_scan(self) -> int:
        """LiDAR packets in a whole sweep."""
        layout = self.info.format
        return max(1, -(-int(layout.columns_per_frame) // int(layout.columns_per_packet)))

    def feed(self, data: memoryview | bytes, received_ns: int, topic: str | None = None) -> list[RawMessage]:
        """Take one datagram and return what it completes; one of neither of the sensor's two sizes gives nothing.

        Parameters
        ----------
        data : bytes
            The datagram.
        received_ns : int
            When it was received [ns].
        topic : str or None
            Topic to give what it completes, from now on; None keeps the one given before.
        """
        size = len(data)
        # The ROS driver of firmware 1 appended a byte to every packet.
        if size - self.format.lidar_packet_size in (0, 1):
            packet = self._packet(self._core.LidarPacket, data, self.format.lidar_packet_size, received_ns)
            self._lidar_topic = topic or self._lidar_topic
            return self.feed_lidar(packet)
        if size - self.format.imu_packet_size in (0, 1):
            self._imu_topic = topic or self._imu_topic
            return self.feed_imu(self._packet(self._core.ImuPacket, data, self.format.imu_packet_size, received_ns))
        return []

    def _packet(self, kind: Any, data: memoryview | bytes, size: int, received_ns: int) -> Any:  # noqa: ANN401
        packet = kind(self.format)
        packet.buf[:] = np.frombuffer(data, dtype=np.uint8, count=size)
        packet.host_timestamp = received_ns
        return packet

    def feed_lidar(self, packet: Any) -> list[RawMessage]:  # noqa: ANN401
        """Take one ``LidarPacket`` of the SDK."""
        if self._frame is None:
            self._frame = self._core.LidarFrame(self.info)
        complete = self._batcher.batch(packet, self._frame)
        self._received_ns = int(packet.host_timestamp)
        return self.finish() if complete else []

    def feed_imu(self, packet: Any) -> list[RawMessage]:  # noqa: ANN401
        """Take one ``ImuPacket`` of the SDK: one sample, or several in the newer profiles."""
        accel, gyro = np.atleast_2d(packet.accel()), np.atleast_2d(packet.gyro())
        stamps = [int(packet.gyro_ts())] if len(gyro) == 1 else np.asarray(packet.timestamp()).astype(np.int64).tolist()
        return [
            RawImu(
                topic=self._imu_topic,
                received_ns=int(packet.host_timestamp),
                stamp_ns=stamp,
                frame_id=IMU_FRAME,
                gyro=(float(w[0]), float(w[1]), float(w[2])),
                accel=(float(a[0]), float(a[1]), float(a[2])),
            )
            for stamp, w, a in zip(stamps, gyro, accel, strict=True)
        ]

    def finish(self) -> list[RawMessage]:
        """Return the sweep collected so far, if it has any measured column, and start the next one."""
        frame, self._frame = self._frame, None
        if frame is None:
            return []
        columns = np.flatnonzero((frame.status & _VALID_COLUMN).astype(bool) & (frame.timestamp > 0))
        if len(columns) == 0:
            return []
        times = frame.timestamp[columns].astype(np.int64)
        stamp_ns = int(times.min())
        # Column by column, so that points come in the order in which they were measured.
        seen = (frame.field("RANGE")[:, columns] > 0).T
        points = self._table(frame.field("RANGE"))[:, columns].transpose(1, 0, 2)[seen]
        table: dict[str, NDArray[np.generic]] = {axis: points[:, i] for i, axis in enumerate("xyz")}
        for name, field in (("intensity", "SIGNAL"), ("reflectivity", "REFLECTIVITY")):
            if frame.has_field(field):
                table[name] = frame.field(field)[:, columns].T[seen].astype(np.float32)
        table.setdefault("intensity", table.get("reflectivity", np.zeros(len(points), np.float32)))
        step, row = np.nonzero(seen)
        table["ring"] = row.astype(np.uint16)
        table["t"] = (times - stamp_ns)[step].astype(np.uint32)
        return [
            RawCloud(
                topic=self._lidar_topic,
                received_ns=self._received_ns,
                stamp_ns=stamp_ns,
                frame_id=LIDAR_FRAME,
                columns=table,
                layout="ouster-packets",
            )
        ]

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str]:
        """Return ``T_imu_lidar`` (lidar being the sensor frame, in which the points are) and the sensor's name.

        The metadata give ``T_sensor_imu`` with its translation in millimetres.
        """
        T_sensor_imu = np.array(self.info.imu_to_sensor_transform, dtype=np.float64)
        T_sensor_imu[:3, 3] *= _MILLIMETRE
        return se3.inverse(T_sensor_imu), f"Ouster {self.info.prod_line}"
