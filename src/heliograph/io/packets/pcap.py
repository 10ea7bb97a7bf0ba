"""Network captures of Ouster and Velodyne sensors as recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.boundary import outside
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.io.packets.ouster import OusterDecoder, is_ouster_metadata, ouster_core
from heliograph.io.packets.pcapfile import datagram_sizes, is_cut, is_pcap
from heliograph.io.packets.velodyne import PACKET_SIZE, VelodyneDecoder, velodyne_decoder
from heliograph.io.raw import RawMessage, RawSource, TopicInfo

__all__ = ["open_pcap"]

_SUFFIXES = (".pcap", ".pcapng")
_OUSTER_TOPICS = ("/ouster/points", "/ouster/imu")
_VELODYNE_TOPIC = "/velodyne_points"
# The last byte of a packet names the model; packets a second there, divided by 10 Hz (Velodyne's manuals).
_VELODYNE_MODELS = {0x21: ("HDL-32E", 181), 0x22: ("VLP-16", 75), 0x24: ("Puck Hi-Res", 75), 0x28: ("VLP-32C", 151),
                    0xA1: ("VLS-128", 625)}  # fmt: skip
_PROBE_PACKETS = 200


def open_pcap(paths: Sequence[Path]) -> RawSource | None:
    """Open captures of one Ouster or Velodyne sensor.

    Parameters
    ----------
    paths : sequence of Path
        ``.pcap`` files, in order, or a folder of them; an Ouster metadata ``.json`` may be among them. If not, it is
        looked for beside the first capture: the one of the same name, else the one that fits its packets.

    Returns
    -------
    RawSource or None
        None if there is no capture among the paths.

    Raises
    ------
    MissingDependencyError
        The vendor's package is not installed; the message names the install command.
    FormatError
        Not a capture, not of one of the two vendors, or Ouster's metadata are missing or fit no packet.
    """
    files = _files_of(paths)
    captures = [path for path in files if path.suffix.lower() in _SUFFIXES]
    if not captures:
        return None
    sizes: Counter[int] = Counter()
    for path in captures:
        if not is_pcap(path):
            raise FormatError(path, "is not a pcap file; record it again with tcpdump or Wireshark")
        sizes.update(datagram_sizes(path))
    if sizes[PACKET_SIZE]:
        return _VelodynePcap(captures, sizes)
    given = [path for path in files if path.suffix.lower() == ".json"]
    return _OusterPcap(captures, _find_metadata(captures[0], given, sizes), sizes)


def _files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the paths, folders replaced by their files."""
    return [inner for path in paths for inner in (sorted(path.iterdir()) if path.is_dir() else [path])]


def _find_metadata(capture: Path, given: Sequence[Path], sizes: Counter[int]) -> Path:
    """Return the metadata file of an Ouster capture."""
    candidates = [path for path in given or _beside(capture) if is_ouster_metadata(path)]
    if not candidates:
        common = ", ".join(str(size) for size, _ in sizes.most_common(3)) or "no known"
        raise FormatError(
            capture,
            f"holds UDP packets of {common} bytes: not Velodyne's, and no Ouster metadata .json lies beside it; add "
            "that file, or convert packets of another sensor with its driver",
        )
    return _only_fitting(capture, candidates)


def _only_fitting(capture: Path, candidates: Sequence[Path]) -> Path:
    fitting = [path for path in candidates if _fits(capture, path)]
    if len(fitting) == 1:
        return fitting[0]
    names = ", ".join(path.name for path in fitting or candidates)
    problem = "several metadata files fit it" if fitting else "its packets fit none of the metadata files beside it"
    raise FormatError(capture, f"{problem} ({names}); name the right .json after the capture")


def _beside(capture: Path) -> list[Path]:
    """Return the JSON file of the capture's name, else all that lie beside it."""
    same_name = capture.with_suffix(".json")
    return [same_name] if same_name.exists() else sorted(capture.parent.glob("*.json"))


def _fits(capture: Path, metadata: Path) -> bool:
    """Tell whether the first LiDAR packet comes from the sensor of this metadata: size, session, serial number."""
    core = ouster_core()
    from ouster.sdk.pcap import PcapPacketSource

    try:
        info = core.SensorInfo(plain_file(metadata, SETTINGS).read_text(encoding="utf-8"))
        source = PcapPacketSource(str(capture), sensor_info=[info])
        packets = [p for _, p in islice(source, _PROBE_PACKETS) if isinstance(p, core.LidarPacket)]
        source.close()
    except (RuntimeError, ValueError):
        return False
    if not packets:
        return False
    session, serial = packets[0].init_id(), packets[0].prod_sn()
    return session in (0, info.init_id) and serial in (0, info.sn)  # legacy packets carry neither: zero


class _Pcap:
    """What both vendors' sources share."""

    description: str
    topics: tuple[TopicInfo, ...]

    def __init__(self, captures: Sequence[Path]) -> None:
        self._captures = tuple(captures)
        self.events: list[Event] = []

    def close(self) -> None:
        """Nothing stays open between iterations."""

    def _guard_damage(
        self, capture: Path, stream: Iterator[RawMessage], errors: tuple[type[Exception], ...]
    ) -> Iterator[RawMessage]:
        """Turn damage of a file into an event: it must not cost what was read before it."""
        damage = ""
        try:
            yield from stream
        except errors as error:
            damage = f"is damaged ({error})"
        if not damage and is_cut(capture):
            damage = "ends inside a packet"
        event = Event(code="truncated", message=f"{capture.name} {damage}; the part before is used")
        if damage and event not in self.events:
            self.events.append(event)


class _OusterPcap(_Pcap):
    def __init__(self, captures: Sequence[Path], metadata: Path, sizes: Counter[int]) -> None:
        super().__init__(captures)
        self._metadata_path = metadata
        self._metadata = plain_file(metadata, SETTINGS).read_text(encoding="utf-8")
        decoder = self._decoder()
        info, layout = decoder.info, decoder.format
        self.description = f"Ouster capture, {info.prod_line}, metadata {metadata.name}"
        scans = sizes[layout.lidar_packet_size] // decoder.packets_per_scan
        lidar, imu = _OUSTER_TOPICS
        self.topics = (
            TopicInfo(name=lidar, message_type="ouster/lidar_packet", kind="lidar", count=scans),
            TopicInfo(name=imu, message_type="ouster/imu_packet", kind="imu", count=sizes[layout.imu_packet_size]),
        )

    def _decoder(self) -> OusterDecoder:
        return OusterDecoder(self._metadata, self._metadata_path, *_OUSTER_TOPICS)

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield clouds and inertial samples as their packets were captured."""
        decoder = self._decoder()
        for capture in self._captures:
            yield from self._guard_damage(
                capture, self._capture_messages(capture, decoder, topics), (RuntimeError, ValueError)
            )
        if _OUSTER_TOPICS[0] in topics:
            yield from decoder.finish()

    def _capture_messages(self, capture: Path, decoder: OusterDecoder, topics: frozenset[str]) -> Iterator[RawMessage]:
        core = ouster_core()
        from ouster.sdk.pcap import PcapPacketSource

        feeds: dict[type, Callable[..., list[RawMessage]]] = {}
        if _OUSTER_TOPICS[0] in topics:
            feeds[core.LidarPacket] = decoder.feed_lidar
        if _OUSTER_TOPICS[1] in topics:
            feeds[core.ImuPacket] = decoder.feed_imu
        source = PcapPacketSource(str(capture), sensor_info=[decoder.info])
        try:
            for _, packet in source:
                feed = feeds.get(type(packet))
                if feed is not None:
                    yield from feed(packet)
        finally:
            source.close()

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the mounting of the built-in IMU, from the metadata."""
        return self._decoder().factory_T_imu_lidar()


class _VelodynePcap(_Pcap):
    def __init__(self, captures: Sequence[Path], sizes: Counter[int]) -> None:
        super().__init__(captures)
        with outside(captures[0]):
            first = next((data for _, data in self._datagrams(captures[0])), b"\0")
        model, packets = _VELODYNE_MODELS.get(first[-1], ("HDL-64E or unknown model", 348))
        self.description = f"Velodyne capture, {model}"
        scans = -(-sizes[PACKET_SIZE] // packets)
        self.topics = (TopicInfo(name=_VELODYNE_TOPIC, message_type="velodyne/packet", kind="lidar", count=scans),)

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield clouds as their last packet was captured."""
        if _VELODYNE_TOPIC not in topics:
            return
        # There is no other sensor in the capture, so the sensor's own clock, which has no jitter, is the better one.
        decoder = VelodyneDecoder(_VELODYNE_TOPIC, device_clock=True, calibration_from=self._captures[0])
        for capture in self._captures:
            errors = (RuntimeError, ValueError, velodyne_decoder().util.dpkt.dpkt.Error)
            yield from self._guard_damage(capture, self._capture_messages(capture, decoder), errors)
        yield from decoder.finish()
        if decoder.bad_packets:
            message = f"{decoder.bad_packets} packets {decoder.why_bad}; they are left out"
            event = Event(code="bad-message", message=message, count=decoder.bad_packets)
            if event not in self.events:
                self.events.append(event)

    def _capture_messages(self, capture: Path, decoder: VelodyneDecoder) -> Iterator[RawMessage]:
        for received_ns, data in self._datagrams(capture):
            yield from decoder.feed(data, received_ns)

    @staticmethod
    def _datagrams(capture: Path) -> Iterator[tuple[int, bytes]]:
        for stamp, data in velodyne_decoder().util.iter_pcap(capture):
            if isinstance(data, bytes) and len(data) == PACKET_SIZE:
                yield round(stamp * 1_000_000_000), data

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return None: a Velodyne's IMU is not part of its packets."""
        return None
