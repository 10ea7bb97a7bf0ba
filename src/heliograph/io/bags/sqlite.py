"""ROS 2 bags in SQLite files (``.db3``), through rosbags."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.io.bags.sqlite_salvage import SqliteSalvage
from heliograph.io.bags.storage import Channel, RawBytes, note, ros2_name

__all__ = ["SqliteStorage"]

MAGIC = b"SQLite format 3\x00"


class SqliteStorage:
    """One SQLite file of a ROS 2 bag.

    Parameters
    ----------
    path : Path
        The file.
    events : list of Event
        Damage is added here.

    Raises
    ------
    FormatError
        Not such a file, or damaged so that its tables cannot be read.
    """

    def __init__(self, path: Path, events: list[Event]) -> None:
        self.path = path
        self.events = events
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FormatError(path, "not an SQLite file: check the file's name and download")
        self._reader = Reader(path)
        self._salvage: SqliteSalvage | None = None
        try:
            self._reader.open()
        except Exception as error:  # rosbags', apsw's and SQLite's own have no common base
            self._open_damaged(error)
            return
        self.channels = [self._channel(c) for c in self._reader.connections]
        counted = self._reader.message_count > 0
        self.start_ns = self._reader.start_time if counted else 0
        self.end_ns = self._reader.end_time - 1 if counted else 0

    def _open_damaged(self, cause: Exception) -> None:
        reason = f"its tables cannot be read ({cause}); recover it with 'sqlite3 BAD.db3 .recover | sqlite3 GOOD.db3'"
        try:
            salvage = SqliteSalvage(self.path)
        except (sqlite3.Error, OSError) as error:
            raise FormatError(self.path, reason) from error
        count = sum(channel.count for channel in salvage.channels)
        if count == 0:
            salvage.close()
            raise FormatError(self.path, reason) from cause
        message = f"{self.path.name} is damaged or unfinished; its {count} readable messages are used"
        note(self.events, Event(code="truncated", message=message))
        self._salvage = salvage
        self.channels, self.start_ns, self.end_ns = salvage.channels, salvage.start_ns, salvage.end_ns

    def close(self) -> None:
        """Release the file."""
        if self._reader.is_open:
            self._reader.close()
        if self._salvage is not None:
            self._salvage.close()
            self._salvage = None

    @staticmethod
    def _channel(connection: Connection) -> Channel:
        kind = ros2_name(connection.msgtype)
        return Channel(topic=connection.topic, message_type=kind, encoding="cdr", count=connection.msgcount)

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        if self._salvage is not None:
            yield from self._salvage.messages(topics, start_ns)
            return
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        channels = {c.id: self._channel(c) for c in connections}
        try:
            for connection, time_ns, data in self._reader.messages(connections, start=start_ns):
                yield channels[connection.id], time_ns, memoryview(data)
        except ReaderError as error:
            self._damage_event(error)
        except Exception as error:
            # SQLite's own errors have no common base with rosbags'; a defect of ours must not hide behind them.
            if type(error).__module__.split(".")[0] not in ("sqlite3", "apsw", "_sqlite3"):
                raise
            self._damage_event(error)

    def _damage_event(self, error: Exception) -> None:
        message = f"{self.path.name} is damaged ({error}); what was read before that is used"
        note(self.events, Event(code="truncated", message=message))
