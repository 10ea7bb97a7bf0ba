"""ROS 1 bags: through rosbags where the index is whole, else chunk by chunk from the start."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.boundary import DAMAGE, outside, outside_each
from heliograph.guard.files import plain_file
from heliograph.guard.limits import ReadLimits
from heliograph.io.bags.storage import Channel, RawBytes, note, ros2_name
from heliograph.io.bags.unpack import UnpackTally, unpack

__all__ = ["Bag1Storage"]

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 0x02, 0x05, 0x07


def _header(body: memoryview) -> dict[str, bytes]:
    """Return the ``name=value`` fields of a record header."""
    fields: dict[str, bytes] = {}
    at = 0
    while at < len(body):
        (size,) = struct.unpack_from("<I", body, at)
        name, _, value = bytes(body[at + 4 : at + 4 + size]).partition(b"=")
        fields[name.decode()] = value
        at += 4 + size
    return fields


def _size(header: Mapping[str, bytes]) -> int | None:
    """Return how many bytes a chunk says that it unpacks to."""
    size = header.get("size", b"")
    return int.from_bytes(size, "little") if len(size) == 4 else None


def _records(body: memoryview, at: int = 0) -> Iterator[tuple[dict[str, bytes], memoryview]]:
    """Yield header and data of the records; EOFError where the last is cut off."""
    while at < len(body):
        (size,) = struct.unpack_from("<I", body, at)
        head = body[at + 4 : at + 4 + size]
        (length,) = struct.unpack_from("<I", body, at + 4 + size)
        data = body[at + 8 + size : at + 8 + size + length]
        if len(head) < size or len(data) < length:
            raise EOFError(f"cut off at byte {len(body)}")
        yield _header(head), data
        at += 8 + size + length


class Bag1Storage:
    """One ROS 1 bag.

    Parameters
    ----------
    path : Path
        The file.
    events : list of Event
        Damage is added here.
    limits : ReadLimits
        How much a chunk may unpack to.

    Raises
    ------
    FormatError
        Not a ROS 1 bag, or nothing in it is readable.
    """

    def __init__(self, path: Path, events: list[Event], limits: ReadLimits | None = None) -> None:
        self.path = path
        self._limits = limits or ReadLimits()
        self._tally = UnpackTally(self._limits)
        self.channels: list[Channel] = []
        self.events = events
        self.start_ns, self.end_ns = 0, 0
        self._reader: Reader | None = None
        self._salvage: _Salvage | None = None
        with plain_file(path).open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FormatError(path, "not a ROS 1 bag (version 2.0): check the file's name and download")
        reader = Reader(path)
        try:
            with outside(path):
                reader.open()
        except FormatError as error:
            self._open_damaged(error.reason)
        else:
            self._reader = reader
            self._open_indexed(reader)

    def close(self) -> None:
        """Release the file."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        if self._salvage is not None:
            yield from self._salvage.messages(topics, start_ns)
            return
        reader = self._reader
        if reader is None:
            return
        connections = [c for c in reader.connections if c.topic in topics]
        channels = {c.id: self._channel(c) for c in reader.connections}
        if not connections:
            return
        try:
            for connection, time_ns, data in outside_each(self.path, reader.messages(connections, start=start_ns)):
                channel = channels.get(connection.id)
                if (
                    channel is not None and channel.topic in topics
                ):  # the index of a damaged file may lead to messages of another connection
                    yield channel, time_ns, memoryview(data)
        except FormatError as error:
            message = f"{self.path.name} {error.reason}; what was read before that is used"
            note(self.events, Event(code="truncated", message=message))

    def _unpacked(self, kind: str, data: bytes) -> bytes:
        """Return a chunk's content; where rosbags would unpack whatever comes, this one ends at the limit."""
        try:
            return bytes(unpack(kind, data, self._limits, tally=self._tally))
        except ValueError as error:
            raise FormatError(self.path, f"is damaged: {error}") from error

    @staticmethod
    def _channel(connection: Connection) -> Channel:
        kind = ros2_name(connection.msgtype)
        return Channel(topic=connection.topic, message_type=kind, encoding="ros1", count=connection.msgcount)

    def _open_indexed(self, reader: Reader) -> None:
        kinds = {function: kind for kind, function in decompressors.items()}
        reader.chunks = {
            at: chunk._replace(decompressor=partial(self._unpacked, kinds[chunk.decompressor]))
            for at, chunk in reader.chunks.items()
        }
        self.channels = [self._channel(c) for c in reader.connections]
        if any(c.count for c in self.channels):
            self.start_ns, self.end_ns = reader.start_time, reader.end_time - 1

    def _open_damaged(self, reason: str) -> None:
        salvage = _Salvage(self.path, self._limits)
        count = sum(c.count for c in salvage.channels)
        if count == 0:
            raise FormatError(self.path, f"no readable message in it ({reason}); record again")
        message = f"{self.path.name} is damaged or unfinished ({reason}); its {count} readable messages are used"
        note(self.events, Event(code="truncated", message=message))
        self._salvage = salvage
        self.channels, self.start_ns, self.end_ns = salvage.channels, salvage.start_ns, salvage.end_ns


class _Salvage:
    """A bag read from its start, chunk by chunk, without its index."""

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        self._path, self._limits, self._tally = path, limits, UnpackTally(limits)
        names: dict[int, tuple[str, str]] = {}
        counts: dict[int, int] = {}
        times: list[int] = []
        for key, time_ns, _ in self._messages(names):
            counts[key] = counts.get(key, 0) + 1
            times.append(time_ns)
        self._by_id = {
            key: Channel(topic=topic, message_type=ros2_name(kind), encoding="ros1", count=counts.get(key, 0))
            for key, (topic, kind) in names.items()
        }
        self.channels = list(self._by_id.values())
        self.start_ns, self.end_ns = (min(times), max(times)) if times else (0, 0)

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield in the order of a chunk's times; chunks follow each other as they were written."""
        for key, time_ns, data in self._messages({}):
            channel = self._by_id.get(key)  # of none: a message before its connection, or without one
            if channel is not None and channel.topic in topics and time_ns >= start_ns:
                yield channel, time_ns, data

    def _chunks(self) -> Iterator[tuple[dict[str, bytes], memoryview]]:
        """Yield the records of the file, whose last may be cut off."""
        size_of_file = self._path.stat().st_size
        with plain_file(self._path).open("rb") as file:
            file.seek(len(MAGIC))
            while len(size := file.read(4)) == 4:
                head = file.read(min(struct.unpack("<I", size)[0], size_of_file))
                length = file.read(4)
                if len(length) < 4:
                    return
                (wanted,) = struct.unpack("<I", length)
                data = memoryview(file.read(min(wanted, size_of_file)))
                yield _header(memoryview(head)), data

    def _messages(self, names: dict[int, tuple[str, str]]) -> Iterator[tuple[int, int, memoryview]]:
        try:
            for header, data in self._chunks():
                if header.get("op", b"")[:1] != bytes([CHUNK]):
                    continue
                found: list[tuple[int, int, int, memoryview]] = []
                kind = header.get("compression", b"").decode(errors="replace")
                body = unpack(kind, data, self._limits, size=_size(header), cut_off=True, tally=self._tally)
                self._read_chunk(body, names, found)
                heapq.heapify(found)
                while found:
                    time_ns, _, key, payload = heapq.heappop(found)
                    yield key, time_ns, payload
        except DAMAGE:
            return

    @staticmethod
    def _read_chunk(
        body: memoryview, names: dict[int, tuple[str, str]], found: list[tuple[int, int, int, memoryview]]
    ) -> None:
        try:
            for header, data in _records(body):
                kind = header["op"][0]
                if kind == CONNECTION:
                    (key,) = struct.unpack("<I", header["conn"])
                    names[key] = (header["topic"].decode(), _header(data)["type"].decode())
                elif kind == MESSAGE:
                    (key,) = struct.unpack("<I", header["conn"])
                    seconds, nanoseconds = struct.unpack("<II", header["time"])
                    found.append((seconds * 1_000_000_000 + nanoseconds, len(found), key, data))
        except DAMAGE:
            return  # the cut-off end of an unfinished chunk
