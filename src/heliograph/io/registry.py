"""Which reader opens which input, in one list, and what a packet topic needs to become points."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import ConfigError, DataError, FormatError
from heliograph.guard.boundary import outside
from heliograph.guard.limits import ReadLimits
from heliograph.io.files.foreign import foreign_format
from heliograph.io.raw import RawMessage, RawSource, TopicInfo
from heliograph.plugins import call_plugin, check_plugin, find_plugin, installed_plugins, plugin_names

__all__ = [
    "OPENERS",
    "PACKET_DRIVERS",
    "Opener",
    "PacketContext",
    "PacketDecoder",
    "open_raw_source",
    "packet_decoder",
    "reader_names",
    "register_reader",
]

Opener = Callable[..., RawSource | None]
"""Takes the paths of one recording; returns it opened, or None where they are of another kind. One that has a parameter
``limits`` gets a `ReadLimits` by that name: how much a file may ask for."""

GROUP = "heliograph.readers"

OPENERS: dict[str, Opener | str] = {
    "rosbag": "heliograph.io.bags.rosbag:open_rosbag",
    "pcap": "heliograph.io.packets.pcap:open_pcap",
    "kitti": "heliograph.io.files.kitti:open_kitti",
    "clouds": "heliograph.io.files.folders:open_cloud_folder",
    "imu": "heliograph.io.files.imu_files:open_imu_file",
}
"""Name -> opener, or ``"module:function"`` of one, asked in this order; `register_reader` puts others before them.
Packages add theirs as entry points of the group ``heliograph.readers``, which are asked last."""

PACKET_DRIVERS: Mapping[str, str] = {
    "ouster_sensor_msgs/msg/PacketMsg": "ouster",
    "ouster_ros/msg/PacketMsg": "ouster",
    "velodyne_msgs/msg/VelodyneScan": "velodyne",
    "hesai_ros_driver/msg/UdpFrame": "hesai_ros_driver",
    "pandar_msgs/msg/PandarScan": "HesaiLidar_General_ROS or nebula",
    "nebula_msgs/msg/NebulaPackets": "nebula",
    "rslidar_msg/msg/RslidarPacket": "rslidar_sdk",
    "rslidar_msgs/msg/rslidarScan": "rslidar_sdk",
}
"""Packet message type -> the driver that makes points of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketContext:
    """What a packet decoder may need beside the packets.

    Parameters
    ----------
    files : tuple of Path
        The recording's files; metadata may lie beside them.
    topics : tuple of TopicInfo
        Topics of the recording.
    texts : mapping of str to str
        Topic -> content of the first ``std_msgs/String`` on it (Ouster's metadata).
    """

    files: tuple[Path, ...]
    topics: tuple[TopicInfo, ...]
    texts: Mapping[str, str]


class PacketDecoder(Protocol):
    """Turns packet messages into raw clouds and samples; it keeps the packets of an unfinished sweep."""

    def decode(self, topic: str, received_ns: int, payload: memoryview, encoding: str) -> list[RawMessage]:
        """Return what the message completes."""
        ...

    def finish(self) -> list[RawMessage]:
        """Return what is left when the stream has ended: the last sweep, whole or not."""
        ...

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the sensor's own ``T_imu_lidar`` and its name, where the metadata tell it."""
        ...


def packet_decoder(message_type: str, context: PacketContext) -> PacketDecoder:
    """Return a fresh decoder for a packet type.

    Raises
    ------
    DataError
        No decoder for this type; the message names the driver that makes points.
    MissingDependencyError
        Its vendor's package is not installed.
    """
    factories: Mapping[str, Callable[[PacketContext], PacketDecoder]] = import_module(
        "heliograph.io.packets.topics"
    ).PACKET_DECODERS
    if message_type not in factories:
        driver = PACKET_DRIVERS.get(message_type, "its driver")
        raise DataError(
            f"{message_type} holds packets, not points; replay it through {driver} and record its PointCloud2"
        )
    return factories[message_type](context)


def register_reader(name: str, opener: Opener | str) -> None:
    """Let a reader open recordings: it is asked before those that stand already, and may be named with ``--reader``.

    Parameters
    ----------
    name : str
        A name that stands already is taken over, and keeps its place.
    opener : callable or str
        Called as ``opener(paths)``; returns a `RawSource`, or None for another kind of file. Or ``"module:function"``
        of such a callable, which is imported when it is needed.

    Raises
    ------
    ConfigError
        A name that is empty or holds a colon.
    """
    if not name or ":" in name:
        raise ConfigError(f"'{name}' cannot name a reader; give a word without a colon")
    others = {} if name in OPENERS else dict(OPENERS)
    for other in others:
        del OPENERS[other]
    OPENERS.update({name: opener, **others})


def reader_names() -> list[str]:
    """Return the names of all readers, registered and installed."""
    return plugin_names(OPENERS, GROUP)


def open_raw_source(paths: Sequence[Path], *, reader: str = "", limits: ReadLimits | None = None) -> RawSource:
    """Open files or folders with the reader that is named, or with the first that knows them.

    Parameters
    ----------
    paths : sequence of Path
        One recording: a file, a folder, or several of them that belong together.
    reader : str
        As registered, of an entry point, or ``"module:function"``; by default all are asked.
    limits : ReadLimits, optional
        How much a file may ask for.

    Raises
    ------
    FormatError
        A path does not exist, is empty, or is no recording that any reader, or the one named, knows.
    ConfigError
        No reader has this name (the message names the nearest), it cannot be imported, fails, or makes no source.
    """
    _check_paths(paths)
    names = [reader] if reader else [*OPENERS, *sorted({*installed_plugins(GROUP)} - {*OPENERS})]
    for name in names:
        opener: Opener = find_plugin("reader", name, OPENERS, GROUP)
        keywords = {"limits": limits or ReadLimits()} if "limits" in _parameters(opener) else {}
        with outside(paths[0], "cannot be read: is it damaged?"):
            source: RawSource | None = call_plugin("reader", name, opener, paths, **keywords)
        if source is not None:
            check_plugin("reader", name, source, RawSource)
            return source
    foreign = "" if reader else foreign_format(paths[0])
    if foreign:
        raise FormatError(paths[0], f"not a recording but {foreign}")
    known = "ROS 1 or 2 bag, MCAP, pcap, KITTI folder, folder of PCD or PLY, IMU table"
    reason = (
        f"not a recording that the reader '{reader}' knows; leave --reader out to ask all"
        if reader
        else (f"not a recording that Heliograph reads ({known})")
    )
    raise FormatError(paths[0], reason)


def _parameters(opener: Opener) -> Mapping[str, object]:
    try:
        return inspect.signature(opener).parameters
    except (TypeError, ValueError):  # of a callable written in C
        return {}


def _check_paths(paths: Sequence[Path]) -> None:
    if not paths:
        raise DataError("no recording given; name a file or a folder")
    for path in paths:
        if not path.exists():
            raise FormatError(path, "no such file or folder; check the path")
        if not path.is_file() and not path.is_dir():
            raise FormatError(path, "neither a file nor a folder; name a recording")
        if path.is_dir() and not any(path.iterdir()):
            raise FormatError(path, "the folder is empty; name a folder that holds a recording")
        if path.is_file() and path.stat().st_size == 0:
            raise FormatError(path, "the file is empty; record or download it again")
