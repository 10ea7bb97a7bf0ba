"""ROS recordings: ROS 1 and ROS 2 bags, bare MCAP files, compressed or not, folders of them, several paths."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from heliograph.data import Event
from heliograph.errors import DataError, FormatError
from heliograph.guard.boundary import DAMAGE, reason
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.guard.limits import ReadLimits
from heliograph.guard.scratch import ScratchFolder
from heliograph.io.bags.bag1 import Bag1Storage
from heliograph.io.bags.mcap import McapStorage
from heliograph.io.bags.messages import DECODERS, KINDS
from heliograph.io.bags.sqlite import SqliteStorage
from heliograph.io.bags.storage import RawBytes, Storage, merge_lazily, note
from heliograph.io.bags.unpack import ZSTD_MAGIC, UnpackTally, unpack, unpack_file
from heliograph.io.raw import RawMessage, RawSource, TopicInfo
from heliograph.io.registry import PACKET_DRIVERS, PacketContext, PacketDecoder, packet_decoder

__all__ = ["RosbagSource", "open_rosbag"]

SUFFIXES = (".mcap", ".bag", ".db3", ".active", ".zstd", ".zst")
STORAGES: dict[bytes, type[McapStorage] | type[Bag1Storage] | type[SqliteStorage]] = {
    b"\x89MCAP0": McapStorage,
    b"#ROSBAG": Bag1Storage,
    b"SQLite format 3": SqliteStorage,
}
STRING = "std_msgs/msg/String"
_MAX_METADATA = 1_000_000  # bytes
_YAML_ALIAS = re.compile(r"(?m)^[^#'\"\n]*[:\-\[,]\s*\*\w")
NO_METADATA: tuple[type[Exception], ...] = (YAMLError, FormatError, AttributeError, *DAMAGE)
MALFORMED: tuple[type[Exception], ...] = (DataError, FormatError, *DAMAGE)


@dataclass(frozen=True, slots=True)
class _Part:
    """A file of the recording; ``zstd_messages`` when each message is compressed by itself."""

    path: Path
    zstd_messages: bool = False


@dataclass(frozen=True, slots=True)
class _OpenPart:
    """An opened file; ``zstd_messages`` as in `_Part`."""

    storage: Storage
    zstd_messages: bool


def open_rosbag(paths: Sequence[Path], limits: ReadLimits | None = None) -> RawSource | None:
    """Open ROS recordings; None where no path is one.

    Parameters
    ----------
    paths : sequence of Path
    limits : ReadLimits, optional
        How much they may unpack to.

    Raises
    ------
    FormatError
        A path is a ROS recording by its name or metadata but cannot be read.
    """
    events: list[Event] = []
    found = [_parts(path, events) for path in paths]
    if not any(found):
        return None
    for path, parts in zip(paths, found, strict=True):
        if not parts:
            raise FormatError(path, "not a ROS recording like the other paths given; open it by itself")
    return RosbagSource(
        [part for parts in found for part in parts],
        description=", ".join(p.name for p in paths),
        events=events,
        limits=limits or ReadLimits(),
    )


def _parts(path: Path, events: list[Event]) -> list[_Part]:
    """Return the files that a path stands for, none where it is no ROS recording."""
    if path.is_file():
        if _is_ros_file(path):
            return [_Part(path)]
        if path.name == "metadata.yaml":
            return _parts(path.parent, events)
        if path.suffix in SUFFIXES:
            raise FormatError(
                path, "neither MCAP, ROS bag nor SQLite by its first bytes; check the file's name and download"
            )
        return []
    if (path / "metadata.yaml").is_file():
        return _described_parts(path, events)
    files = sorted(p for p in path.iterdir() if p.is_file() and p.suffix in SUFFIXES and _is_ros_file(p))
    if files:
        return [_Part(file) for file in files]
    return [part for folder in sorted(path.iterdir()) if folder.is_dir() for part in _bag_folder(folder, events)]


def _bag_folder(folder: Path, events: list[Event]) -> list[_Part]:
    """Return the parts of a sub-folder that is itself a bag."""
    is_bag = (folder / "metadata.yaml").is_file() or any(p.suffix in SUFFIXES for p in folder.iterdir())
    return _parts(folder, events) if is_bag else []


def _is_ros_file(path: Path) -> bool:
    with plain_file(path).open("rb") as file:
        head = file.read(16)
    return head.startswith((*STORAGES, ZSTD_MAGIC))


def _described_parts(folder: Path, events: list[Event]) -> list[_Part]:
    """Return the files that ``metadata.yaml`` lists, or those that are there where it cannot be used."""
    path = folder / "metadata.yaml"
    try:
        content = _metadata(path)
        names = [PurePosixPath(str(name)).name for name in content["relative_file_paths"]]
        mode = str(content.get("compression_mode") or "").lower()
    except NO_METADATA as error:
        message = f"{path} {reason('is not usable', error)}; the files beside it are read"
        note(events, Event(code="bad-metadata", message=message))
        names, mode = sorted(p.name for p in folder.iterdir() if p.suffix in SUFFIXES), ""
    there = [name for name in names if (folder / name).is_file()]
    if not there:
        raise FormatError(path, f"none of its {len(names)} files is there; copy the whole folder")
    if len(there) < len(names):
        lost = ", ".join(name for name in names if name not in there)
        note(
            events,
            Event(code="missing-file", message=f"{folder}: {lost} is missing; the other {len(there)} files are used"),
        )
    return [_Part(folder / name, mode == "message") for name in there]


def _metadata(path: Path) -> Any:  # noqa: ANN401 - whatever the file holds
    """Return what a ``metadata.yaml`` says; one that refers to itself, which may stand for any amount, is refused."""
    if path.stat().st_size > _MAX_METADATA:
        raise FormatError(path, f"is larger than {_MAX_METADATA / 1e6:.0f} MB")
    text = plain_file(path, SETTINGS).read_text(encoding="utf-8", errors="replace")
    if _YAML_ALIAS.search(text):
        raise FormatError(path, "refers to parts of itself")
    return YAML(typ="safe").load(text)["rosbag2_bagfile_information"]


class RosbagSource:
    """The messages of one ROS recording, of any number of files.

    Parameters
    ----------
    parts : list
        Its files.
    description : str
        For messages and reports.
    events : list of Event
        What was noticed so far; damage is added.
    limits : ReadLimits
        How much they may unpack to.
    """

    def __init__(self, parts: list[_Part], *, description: str, events: list[Event], limits: ReadLimits) -> None:
        self.description = description
        self.events = events
        self._limits = limits
        self._folder: ScratchFolder | None = None
        self._files = tuple(part.path for part in parts)
        self._parts: list[_OpenPart] = []
        try:
            self._open(parts)
        except BaseException:
            self.close()
            raise
        try:
            self.topics = self._collect_topics()
        except FormatError:
            self.close()
            raise
        self._types = {topic.name: topic.message_type for topic in self.topics}
        self._packets: dict[str, PacketDecoder] = {}

    def _open(self, parts: list[_Part]) -> None:
        failure: FormatError | None = None
        for part in parts:
            try:
                storage = self._open_storage(part.path)
            except FormatError as error:
                failure = error
                note(self.events, Event(code="unreadable-file", message=f"{error}; the other files are used"))
                continue
            self._parts.append(_OpenPart(storage, part.zstd_messages))
        if not self._parts and failure is not None:
            raise failure

    def _open_storage(self, path: Path) -> Storage:
        with plain_file(path).open("rb") as file:
            head = file.read(16)
        if head.startswith(ZSTD_MAGIC):
            return self._open_unpacked(path)
        for magic, storage in STORAGES.items():
            if head.startswith(magic):
                return storage(path, self.events, self._limits)
        raise FormatError(
            path, "neither MCAP, ROS bag nor SQLite by its first bytes; check the file's name and download"
        )

    def _open_unpacked(self, path: Path) -> Storage:
        """Open a temporary copy of a zstd-compressed file, for readers seek; what is said names the file itself."""
        if self._folder is None:
            self._folder = ScratchFolder()
        target = self._folder.path / f"{len(self._parts)}-{path.stem}"
        try:
            damage = unpack_file(path, target, self._limits)
        except ValueError as error:
            target.unlink(missing_ok=True)
            raise FormatError(path, str(error)) from error
        except OSError as error:
            target.unlink(missing_ok=True)
            raise FormatError(path, reason(f"cannot be unpacked into {target.parent}", error)) from error
        if damage:
            message = f"{path.name} does not unpack to its end ({damage}); the part before is used"
            note(self.events, Event(code="truncated", message=message))
        with target.open("rb") as file:
            nested = file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
        if nested:
            raise FormatError(path, "is compressed twice; unpack it with `zstd -d` and open what comes out")
        said = len(self.events)
        try:
            return self._open_storage(target)
        except FormatError as error:
            raise FormatError(path, error.reason) from error
        finally:  # the copy's name says nothing to anybody
            self.events[said:] = [
                replace(event, message=event.message.replace(target.name, path.name)) for event in self.events[said:]
            ]

    def _collect_topics(self) -> tuple[TopicInfo, ...]:
        found: dict[str, TopicInfo] = {}
        for part in self._parts:
            for channel in part.storage.channels:
                kind = _kind(channel.topic, channel.message_type, channel.encoding)
                known = found.get(channel.topic)
                info = TopicInfo(name=channel.topic, message_type=channel.message_type, kind=kind, count=channel.count)
                found[channel.topic] = replace(known, count=known.count + channel.count) if known else info
        if len(found) > self._limits.topics:
            raise FormatError(
                self._files[0], f"holds {len(found)} topics, more than any recording; the file is damaged"
            )
        return tuple(sorted(found.values(), key=lambda topic: topic.name))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception in the recording [ns]."""
        spans = [(p.storage.start_ns, p.storage.end_ns) for p in self._parts if p.storage.end_ns > 0]
        return (min(a for a, _ in spans), max(b for _, b in spans)) if spans else (0, 0)

    def messages(self, topics: frozenset[str], start_ns: int = 0) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in the order in which they were received.

        Damage ends a file's stream and is added to ``events``; a message that cannot be decoded is skipped and counted.
        """
        packets: dict[str, PacketDecoder] = {}
        for channel, received_ns, payload in self._payloads(topics, start_ns):
            decode = DECODERS.get(channel.message_type)
            try:
                if decode is not None:
                    yield from decode(channel.topic, received_ns, payload, channel.encoding)
                elif channel.message_type in PACKET_DRIVERS:
                    if channel.message_type not in packets:
                        packets[channel.message_type] = self._packet_decoder(channel.message_type)
                    yield from packets[channel.message_type].decode(
                        channel.topic, received_ns, payload, channel.encoding
                    )
            except MALFORMED as error:
                if channel.message_type in PACKET_DRIVERS and channel.message_type not in packets:
                    raise
                note_bad_message(self.events, channel.topic, received_ns, error)
        for decoder in packets.values():
            yield from decoder.finish()

    def _payloads(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        streams = [
            (max(part.storage.start_ns, start_ns), partial(_read, part, topics, start_ns, self.events, self._limits))
            for part in self._parts
            if part.storage.end_ns >= start_ns
        ]
        return merge_lazily(streams, key=lambda item: item[1])

    def _packet_decoder(self, message_type: str) -> PacketDecoder:
        texts: dict[str, str] = {}
        names = frozenset(
            topic.name for topic in self.topics if topic.message_type == STRING and "metadata" in topic.name
        )
        for channel, _, payload in self._payloads(names, 0):
            at = 4 if channel.encoding == "cdr" else 0
            texts.setdefault(channel.topic, bytes(payload[at + 4 :]).rstrip(b"\0").decode(errors="replace"))
        return packet_decoder(message_type, PacketContext(files=self._files, topics=self.topics, texts=texts))

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the sensor's own ``T_imu_lidar`` and its name, where packets come with the metadata that tell it."""
        for message_type in sorted({topic.message_type for topic in self.topics if topic.kind == "lidar-packets"}):
            known = self._packet_decoder(message_type).factory_T_imu_lidar()
            if known is not None:
                return known
        return None

    def close(self) -> None:
        """Release the files."""
        for part in self._parts:
            part.storage.close()
        self._parts = []
        if self._folder is not None:
            self._folder.close()
            self._folder = None


def _kind(topic: str, message_type: str, encoding: str) -> str:
    if encoding not in ("cdr", "ros1"):
        return "other"
    if message_type in PACKET_DRIVERS:
        return "imu" if "imu" in topic.lower() else "lidar-packets"
    return KINDS.get(message_type, "other")


def _read(
    part: _OpenPart, topics: frozenset[str], start_ns: int, events: list[Event], limits: ReadLimits
) -> Iterator[RawBytes]:
    tally = UnpackTally(limits)
    for channel, received_ns, payload in part.storage.messages(topics, start_ns):
        if not part.zstd_messages:
            yield channel, received_ns, payload
            continue
        try:
            content = unpack("zstd", payload, limits, tally=tally)
        except ValueError as error:
            note_bad_message(events, channel.topic, received_ns, error)
            continue
        yield channel, received_ns, content


def note_bad_message(events: list[Event], topic: str, received_ns: int, error: Exception) -> None:
    """Report the first message of a topic that cannot be decoded."""
    if not any(event.code == "bad-message" and f" {topic} " in event.message for event in events):
        message = f"a message on {topic} cannot be decoded ({error}); such messages are skipped"
        events.append(Event(code="bad-message", message=message, stamp_ns=received_ns))
