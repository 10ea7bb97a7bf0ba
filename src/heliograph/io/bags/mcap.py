"""MCAP files, finished or not.

The container format is public (mcap.dev, version 1): records of one opcode byte, a 64-bit length and a body;
messages sit in chunks that may be compressed; a summary at the end repeats schemas and channels and indexes the
chunks. A recorder that was killed leaves no summary, or half a chunk: then the file is walked from its start and
everything that is complete is used. Payloads are views into the decompressed chunk, so that a point cloud is not
copied on its way out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.boundary import DAMAGE
from heliograph.guard.files import plain_file
from heliograph.guard.limits import MAX_NS, ReadLimits
from heliograph.io.bags.storage import Channel, RawBytes, merge_lazily, note, ros2_name
from heliograph.io.bags.unpack import UnpackTally, unpack

__all__ = ["McapStorage"]

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, CHUNK_INDEX, STATISTICS, DATA_END = (
    0x02,
    0x03,
    0x04,
    0x05,
    0x06,
    0x08,
    0x0B,
    0x0F,
)
FOOTER_BYTES = 9 + 20 + 8
RECORD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
END_OF_TIME_NS = MAX_NS
CLOCK_SET_BACK_NS = 800_000_000  # by which no recorder writes a message late
ENCODINGS = {"cdr": "cdr", "ros1": "ros1"}


_USUAL = ReadLimits()


@dataclass(frozen=True, slots=True)
class _Chunk:
    start_ns: int
    end_ns: int
    offset: int
    length: int
    channels: frozenset[int] | None  # None: the index does not tell which channels it holds


def _text(body: memoryview, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    return bytes(body[at + 4 : at + 4 + size]).decode(errors="replace"), at + 4 + size


def _records(body: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and body of the complete records in ``body``."""
    at, end = 0, len(body)
    while at + RECORD.size <= end:
        opcode, size = RECORD.unpack_from(body, at)
        at += RECORD.size
        if at + size > end:
            raise EOFError("a record is cut off")
        yield opcode, body[at : at + size]
        at += size


def _decompress(body: memoryview, limits: ReadLimits = _USUAL, tally: UnpackTally | None = None) -> memoryview:
    """Return the records of a chunk; of one that is cut off, as much as can be had."""
    (_, _, size, _) = struct.unpack_from("<QQQI", body, 0)
    compression, at = _text(body, 28)
    (stored,) = struct.unpack_from("<Q", body, at)
    data = body[at + 8 : at + 8 + stored]
    return unpack(compression, data, limits, size=size, cut_off=len(data) < stored, tally=tally)


class McapStorage:
    """One MCAP file, read through its summary where it has one.

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
        Not an MCAP file, or nothing in it is readable.
    """

    def __init__(self, path: Path, events: list[Event], limits: ReadLimits | None = None) -> None:
        self.path = path
        self._limits = limits or _USUAL
        self._tally = UnpackTally(self._limits)
        self.channels: list[Channel] = []
        self.events = events
        self.start_ns, self.end_ns = END_OF_TIME_NS, 0
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[_Chunk] = []
        self._loose = False  # messages outside chunks
        self._file: BinaryIO = plain_file(path).open("rb")
        self._size = path.stat().st_size
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        wanted = {key: channel for key, channel in self._by_id().items() if channel.topic in topics}
        if not wanted:
            return
        if self._loose:
            yield from self._read_loose(wanted, start_ns)
            return
        if self._clock_was_set_back():
            # Sorted by time, what came after the step would lie between what came before it.
            for chunk in sorted(self._chunks, key=lambda chunk: chunk.offset):
                yield from self._read_chunk(chunk, wanted, start_ns)
            return
        chunks = [
            (chunk.start_ns, partial(self._read_chunk, chunk, wanted, start_ns))
            for chunk in self._chunks
            if chunk.end_ns >= start_ns and (chunk.channels is None or not chunk.channels.isdisjoint(wanted))
        ]
        yield from merge_lazily(chunks, key=lambda item: item[1])

    def _clock_was_set_back(self) -> bool:
        """Whether the recorder's clock ran back between two chunks, as their spans tell.

        Writers that put each topic into chunks of its own overlap by any amount: only chunks of one topic are compared.
        """
        last: dict[int, int] = {}
        for chunk in sorted((chunk for chunk in self._chunks if chunk.end_ns), key=lambda chunk: chunk.offset):
            keys = chunk.channels if chunk.channels is not None else frozenset(self._channels)
            if any(chunk.start_ns < last.get(key, 0) - CLOCK_SET_BACK_NS for key in keys):
                return True
            last.update(dict.fromkeys(keys, chunk.end_ns))
        return False

    def _by_id(self) -> dict[int, Channel]:
        return {
            key: Channel(topic=topic, message_type=kind, encoding=encoding, count=self._counts.get(key, 0))
            for key, (topic, kind, encoding) in self._channels.items()
        }

    def _open(self) -> None:
        head = self._file.read(len(MAGIC))
        if head != MAGIC:
            raise FormatError(
                self.path, "not an MCAP file: its first bytes are not MCAP's; check the file's name and download"
            )
        try:
            complete = self._read_summary()
        except DAMAGE:
            complete = False
        if not complete:  # the summary, or an optional part of it, is missing or damaged
            self._schemas, self._channels, self._chunks, self._counts = {}, {}, [], {}
            self.start_ns, self.end_ns = END_OF_TIME_NS, 0
            self._walk()
        self.channels = list(self._by_id().values())
        if self.start_ns == END_OF_TIME_NS:
            self.start_ns = 0

    def _read_summary(self) -> bool:
        """Read schemas, channels and the chunk index from the end of the file; False where it has none."""
        size = self._size
        if size < len(MAGIC) + FOOTER_BYTES:
            return False
        self._file.seek(size - FOOTER_BYTES)
        footer = self._file.read(FOOTER_BYTES)
        if footer[-len(MAGIC) :] != MAGIC or footer[0] != FOOTER:
            return False
        (summary,) = struct.unpack_from("<Q", footer, 9)
        if not len(MAGIC) <= summary < size:
            return False
        self._file.seek(summary)
        body = memoryview(self._file.read(size - FOOTER_BYTES - summary))
        complete = False
        for opcode, record in _records(body):
            self._read_definition(opcode, record)
            if opcode == CHUNK_INDEX:
                self._chunks.append(self._chunk_from_index(record))
            elif opcode == STATISTICS:
                messages, _, _, _, _, chunks, first, last = struct.unpack_from("<QHIIIIQQ", record, 0)
                self.start_ns, self.end_ns = (first, min(last, END_OF_TIME_NS)) if messages else (END_OF_TIME_NS, 0)
                (length,) = struct.unpack_from("<I", record, 42)
                self._counts = dict(struct.iter_unpack("<HQ", record[46 : 46 + length]))
                complete = bool(self._channels) and (messages == 0 or chunks == len(self._chunks) > 0)
        return complete

    @staticmethod
    def _chunk_from_index(record: memoryview) -> _Chunk:
        first, last, offset, length, entries = struct.unpack_from("<QQQQI", record, 0)
        channels = frozenset(key for key, _ in struct.iter_unpack("<HQ", record[36 : 36 + entries]))
        return _Chunk(first, last, offset, length, channels or None)

    def _read_definition(self, opcode: int, record: memoryview) -> None:
        if opcode == SCHEMA:
            (key,) = struct.unpack_from("<H", record, 0)
            self._schemas[key] = ros2_name(_text(record, 2)[0])
        elif opcode == CHANNEL:
            key, schema = struct.unpack_from("<HH", record, 0)
            topic, at = _text(record, 4)
            encoding, _ = _text(record, at)
            self._channels[key] = (topic, self._schemas.get(schema, ""), ENCODINGS.get(encoding, encoding))

    def _walk(self) -> None:
        """Index a file without summary record by record; what is cut off ends it with a warning."""
        try:
            for opcode, record, offset in self._top_level():
                self._read_definition(opcode, record)
                if opcode == MESSAGE:
                    self._loose = True
                    self._count_message(record)
                elif opcode == CHUNK:
                    self._index_chunk(record, offset)
                elif opcode in (DATA_END, FOOTER):
                    return
            reason = "it has no end record"
        except DAMAGE as error:
            reason = str(error)
        count = sum(self._counts.values())
        if count == 0:
            raise FormatError(
                self.path, f"no readable message in it ({reason}); record again or recover it with its recorder"
            )
        message = f"{self.path.name} is damaged or unfinished ({reason}); its {count} readable messages are used"
        note(self.events, Event(code="truncated", message=message))

    def _count_message(self, record: memoryview) -> int:
        key, _, time_ns, _ = MESSAGE_HEAD.unpack_from(record, 0)
        if time_ns >= END_OF_TIME_NS:
            raise ValueError(f"a message was received at {time_ns} ns")
        self._counts[key] = self._counts.get(key, 0) + 1
        self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
        return int(key)

    def _note_damage(self, offset: int, length: int, error: Exception) -> None:
        if offset + length >= self._size:
            return  # the file's cut-off end, which is reported as such
        message = f"{self.path.name}: the chunk at byte {offset} is damaged ({error}); its readable part is used"
        note(self.events, Event(code="damaged-chunk", message=message))

    def _index_chunk(self, record: memoryview, offset: int) -> None:
        keys: set[int] = set()
        try:
            for opcode, inner in _records(_decompress(record, self._limits, self._tally)):
                self._read_definition(opcode, inner)
                if opcode == MESSAGE:
                    keys.add(self._count_message(inner))
        except DAMAGE as error:  # the messages before it are as good as any, and so are the chunks after it
            self._note_damage(offset, len(record) + RECORD.size, error)
        first, last = struct.unpack_from("<QQ", record, 0)
        self._chunks.append(_Chunk(first, last, offset, len(record) + RECORD.size, frozenset(keys)))

    def _top_level(self) -> Iterator[tuple[int, memoryview, int]]:
        """Yield opcode, body and offset of the outer records; a cut-off chunk is yielded before the error."""
        at = len(MAGIC)
        while True:
            self._file.seek(at)
            head = self._file.read(RECORD.size)
            opcode, size = RECORD.unpack(head) if len(head) == RECORD.size else (0, 0)
            if opcode == 0:
                raise EOFError("it has no end record: its recorder was stopped before it finished the file")
            body = memoryview(self._file.read(min(size, self._size - at)))
            if len(body) == size or opcode == CHUNK:
                yield opcode, body, at
            if len(body) < size:
                raise EOFError(f"cut off at byte {at + RECORD.size + len(body)}")
            if opcode == FOOTER:
                return
            at += RECORD.size + size

    def _read_chunk(self, chunk: _Chunk, wanted: dict[int, Channel], start_ns: int) -> Iterator[RawBytes]:
        found: list[RawBytes] = []
        try:
            self._file.seek(chunk.offset + RECORD.size)
            body = memoryview(self._file.read(max(0, min(chunk.length, self._size) - RECORD.size)))
            for opcode, record in _records(_decompress(body, self._limits, self._tally)):
                if opcode != MESSAGE:
                    continue
                key, _, time_ns, _ = MESSAGE_HEAD.unpack_from(record, 0)
                if key in wanted and start_ns <= time_ns < END_OF_TIME_NS:
                    found.append((wanted[key], time_ns, record[MESSAGE_HEAD.size :]))
        except DAMAGE as error:
            self._note_damage(chunk.offset, chunk.length, error)
        if all(after[1] >= before[1] - CLOCK_SET_BACK_NS for before, after in pairwise(found)):
            found.sort(key=lambda item: item[1])
        return iter(found)

    def _read_loose(self, wanted: dict[int, Channel], start_ns: int) -> Iterator[RawBytes]:
        """Read a file whose messages are not in chunks: they come in the order in which they were written."""
        try:
            for opcode, record, _ in self._top_level():
                records = (
                    _records(_decompress(record, self._limits, self._tally))
                    if opcode == CHUNK
                    else iter([(opcode, record)])
                )
                for inner, body in records:
                    if inner == MESSAGE:
                        key, _, time_ns, _ = MESSAGE_HEAD.unpack_from(body, 0)
                        if key in wanted and start_ns <= time_ns < END_OF_TIME_NS:
                            yield wanted[key], time_ns, body[MESSAGE_HEAD.size :]
        except DAMAGE:
            return  # reported when the file was indexed
