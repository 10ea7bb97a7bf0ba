"""What can still be read of a ROS 2 bag's SQLite file that is cut off or damaged."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import tempfile
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

from heliograph.io.bags.storage import Channel, RawBytes, ros2_name

__all__ = ["SqliteSalvage"]

HEADER_BYTES = 100


class SqliteSalvage:
    """A damaged file, row by row up to the first that is lost.

    SQLite refuses a file that is shorter than its header says. A temporary copy is made as long as it should be, the
    lost pages blank; then every row before them can be read. (File format: sqlite.org/fileformat2.html, 1.3.)

    Parameters
    ----------
    path : Path
        The file; at least its header and its table of topics must be whole.

    Raises
    ------
    sqlite3.Error
        They are not.
    """

    def __init__(self, path: Path) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="heliograph-")
        self._db: sqlite3.Connection | None = None
        try:
            copy = Path(self._folder.name) / "padded.db3"
            shutil.copyfile(path, copy)
            _pad(copy)
            # The stream may be read in another thread than the one that opened it, but never in two at once.
            self._db = sqlite3.connect(f"{copy.as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False)
            topics = {
                key: (name, ros2_name(kind)) for key, name, kind in self._query("SELECT id, name, type FROM topics")
            }
            self._rows = sorted(self._readable_rows(topics.keys()), key=lambda row: row[1])
        except BaseException:
            self.close()
            raise
        counts = Counter(key for _, _, key in self._rows)
        self._channels = {
            key: Channel(topic=name, message_type=kind, encoding="cdr", count=counts[key])
            for key, (name, kind) in topics.items()
        }
        self.channels = list(self._channels.values())
        self.start_ns, self.end_ns = (self._rows[0][1], self._rows[-1][1]) if self._rows else (0, 0)

    def close(self) -> None:
        """Release the copy."""
        if self._db is not None:
            self._db.close()
            self._db = None
        self._folder.cleanup()

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        for row, time_ns, key in self._rows:
            if time_ns < start_ns or self._channels[key].topic not in topics:
                continue
            try:
                data = next(self._query("SELECT data FROM messages WHERE id = ?", row), None)
            except sqlite3.Error:
                continue  # its payload reaches into the lost pages
            if data is not None:
                yield self._channels[key], time_ns, memoryview(data[0])

    def _query(self, statement: str, *values: int) -> Iterator[tuple[Any, ...]]:
        if self._db is not None:
            yield from self._db.execute(statement, values)

    def _readable_rows(self, topics: Container[int]) -> list[tuple[int, int, int]]:
        """Return id, time and topic of the rows in front of the damage."""
        rows: list[tuple[int, int, int]] = []
        try:
            for row, time_ns, key in self._query("SELECT id, timestamp, topic_id FROM messages"):
                if key in topics and isinstance(time_ns, int):
                    rows.append((row, time_ns, key))
        except sqlite3.Error:
            return rows
        return rows


def _pad(path: Path) -> None:
    """Make a database file as long as its header says."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
    if len(header) < HEADER_BYTES:
        raise sqlite3.DatabaseError("shorter than its header")
    (page,) = struct.unpack_from(">H", header, 16)
    (pages,) = struct.unpack_from(">I", header, 28)
    wanted = (65536 if page == 1 else page) * pages
    if wanted > path.stat().st_size:
        os.truncate(path, wanted)
