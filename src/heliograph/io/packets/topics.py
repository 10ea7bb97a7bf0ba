"""Packet topics of ROS bags to points: which message type has a decoder, and how its bytes are laid out."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import DataError
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.io.packets.ouster import OusterDecoder, is_ouster_metadata
from heliograph.io.packets.velodyne import PACKET_SIZE, VelodyneDecoder, velodyne_decoder
from heliograph.io.raw import RawMessage

if TYPE_CHECKING:
    from heliograph.io.registry import PacketContext, PacketDecoder

__all__ = ["PACKET_DECODERS", "OusterPackets", "VelodynePackets"]

_CDR_HEADER = 4


class OusterPackets:
    """Decodes ``PacketMsg`` of the Ouster drivers: a byte array. One sensor for each namespace of topics.

    Parameters
    ----------
    context : PacketContext
        The metadata are the text on a topic ``metadata`` of the same namespace, or a JSON file beside the bag.

    Raises
    ------
    DataError
        No metadata.
    MissingDependencyError
        ouster-sdk is not installed.
    """

    def __init__(self, context: PacketContext) -> None:
        self._metadata = _ouster_metadata(context)
        self._sensors: dict[str, OusterDecoder] = {}
        for namespace, (text, source) in self._metadata.items():
            self._sensors[namespace] = OusterDecoder(
                text, source, f"{namespace}/lidar_packets", f"{namespace}/imu_packets"
            )

    def decode(self, topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
        """Return the sweep or the samples that the packet completes, on the packet's topic."""
        at, order = _start(payload, encoding)
        (size,) = struct.unpack_from(order + "I", payload, at)
        data = payload[at + 4 : at + 4 + size]
        if len(data) < size:
            raise DataError(f"packet of {size} bytes is cut to {len(data)}")
        return self._sensor(topic).feed(data, received_ns, topic)

    def finish(self) -> list[RawMessage]:
        """Return the unfinished sweep of each sensor."""
        return [message for sensor in self._sensors.values() for message in sensor.finish()]

    def _sensor(self, topic: str) -> OusterDecoder:
        namespace = topic.rpartition("/")[0]
        return self._sensors.get(namespace) or next(iter(self._sensors.values()))

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the mounting of the built-in IMU, from the metadata."""
        return next(iter(self._sensors.values())).factory_T_imu_lidar()


def _ouster_metadata(context: PacketContext) -> dict[str, tuple[str, Path | str]]:
    """Return the metadata and where they come from, by namespace."""
    texts = {
        topic.rpartition("/")[0]: (text, topic)
        for topic, text in context.texts.items()
        if "beam_altitude_angles" in text
    }
    if texts:
        return dict(texts)
    found = _metadata_files(context.files)
    if len(found) != 1:
        names = ", ".join(json.name for json in found) or "none"
        raise DataError(
            "Ouster packets need the sensor's metadata: a std_msgs/String topic 'metadata' in the bag, or one .json "
            f"beside it (found: {names})"
        )
    return {"": (plain_file(found[0], SETTINGS).read_text(encoding="utf-8"), found[0])}


def _metadata_files(files: Sequence[Path]) -> list[Path]:
    """Return the metadata files beside a recording; one that bears its name goes before others."""
    beside = sorted({json for file in files for json in file.parent.glob("*.json") if is_ouster_metadata(json)})
    names = {file.stem for file in files}
    return [json for json in beside if json.stem in names] or beside


class VelodynePackets:
    """Decodes ``velodyne_msgs/VelodyneScan``: a header and packets of 1206 bytes. One sensor for each topic.

    Sweeps are cut anew by azimuth, and stamped by the packets' stamps, which are in the clock of the recording's other
    sensors.
    """

    def __init__(self, context: PacketContext) -> None:  # noqa: ARG002 - every decoder is made from a context
        velodyne_decoder()
        self._sensors: dict[str, VelodyneDecoder] = {}

    def decode(self, topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
        """Return the sweeps that the message completes."""
        frame_id, packets = _velodyne_packets(payload, encoding)
        if topic not in self._sensors:
            self._sensors[topic] = VelodyneDecoder(topic, frame_id)
        return [
            cloud
            for stamp_ns, data in packets
            for cloud in self._sensors[topic].feed(data, received_ns, stamp_ns=stamp_ns)
        ]

    def finish(self) -> list[RawMessage]:
        """Return the unfinished sweep of each sensor."""
        return [message for sensor in self._sensors.values() for message in sensor.finish()]

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return None: a Velodyne's IMU is not part of its packets."""
        return None


def _start(payload: memoryview, encoding: str) -> tuple[int, str]:
    """Return where the message begins and its byte order."""
    if encoding != "cdr":
        return 0, "<"
    return _CDR_HEADER, "<" if payload[1] & 1 else ">"


def _velodyne_packets(payload: memoryview, encoding: str) -> tuple[str, Iterator[tuple[int, bytes]]]:
    """Return the frame and the packets of a ``VelodyneScan`` with the stamp of each [ns]."""
    base, order = _start(payload, encoding)
    align = 4 if encoding == "cdr" else 1
    at = base + (8 if encoding == "cdr" else 12)
    (length,) = struct.unpack_from(order + "I", payload, at)
    frame_id = bytes(payload[at + 4 : at + 4 + length]).rstrip(b"\0").decode(errors="replace")
    at += 4 + length
    at += -(at - base) % align
    (count,) = struct.unpack_from(order + "I", payload, at)
    stride = 8 + PACKET_SIZE + (-PACKET_SIZE % align)
    if at + 4 + count * stride - (stride - 8 - PACKET_SIZE) > len(payload):
        raise DataError(f"{count} Velodyne packets need more than the message's {len(payload)} bytes")

    def packets() -> Iterator[tuple[int, bytes]]:
        for start in range(at + 4, at + 4 + count * stride, stride):
            seconds, nanoseconds = struct.unpack_from(order + "II", payload, start)
            yield seconds * 1_000_000_000 + nanoseconds, bytes(payload[start + 8 : start + 8 + PACKET_SIZE])

    return frame_id, packets()


PACKET_DECODERS: Mapping[str, Callable[[PacketContext], PacketDecoder]] = {
    "ouster_ros/msg/PacketMsg": OusterPackets,
    "ouster_sensor_msgs/msg/PacketMsg": OusterPackets,
    "velodyne_msgs/msg/VelodyneScan": VelodynePackets,
}
"""Message type in the ROS 2 spelling -> its decoder."""
