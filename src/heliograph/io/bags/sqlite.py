"""ROS 2 bags in SQLite files (``.db3``), whole or damaged.

A database is a program as well: what should be a table of messages may be a query that never ends. So only plain tables
are read, and of their rows only the stamps first.
"""

from __future__ import annotations

import sqlite3
import sys
from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.files import plain_file
from heliograph.guard.limits import MAX_NS, ReadLimits
from heliograph.io.bags.sqlite_salvage import PaddedCopy
from heliograph.io.bags.storage import Channel, RawBytes, note, ros2_name

__all__ = ["SqliteStorage"]

MAGIC = b"SQLite format 3\x00"
TABLES = ("messages", "topics")
_LEAST_ROW = 4  # bytes of a row in the file at least
_RECOVER = "recover it with 'sqlite3 BAD.db3 .recover | sqlite3 GOOD.db3'"


class SqliteStorage:
    """One SQLite file of a ROS 2 bag.

    Parameters
    ----------
    path : Path
        The file.
    events : list of Event
        Damage is added here.
    limits : ReadLimits
        How long a message may be, and how many topics there may be.

    Raises
    ------
    FormatError
        Not such a file, or damaged so that its tables cannot be read.
    """

    def __init__(self, path: Path, events: list[Event], limits: ReadLimits | None = None) -> None:
        self.path, self.events = path, events
        self._limits = limits or ReadLimits()
        with plain_file(path).open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FormatError(path, "not an SQLite file: check the file's name and download")
        self._copy: PaddedCopy | None = None
        self._rows: _Rows | None = None
        try:
            self._rows = _Rows(path, path, self._limits)
            damage = self._rows.damage
        except sqlite3.Error as error:
            damage = str(error)
        except BaseException:
            self.close()
            raise
        if damage:
            self._open_damaged(damage)
        self._describe()

    def _open_damaged(self, cause: str) -> None:
        """Read what is left of a file whose tables are not whole: a copy as long as its header says."""
        try:
            if self._rows is not None:
                self._rows.close()
            self._copy = PaddedCopy(self.path, self._limits)
            self._rows = _Rows(self._copy.path, self.path, self._limits)
        except (sqlite3.Error, OSError) as error:
            self.close()
            raise FormatError(self.path, f"its tables cannot be read ({cause}); {_RECOVER}") from error
        except BaseException:
            self.close()
            raise
        if not len(self._rows):
            self.close()
            raise FormatError(self.path, f"its tables cannot be read ({cause}); {_RECOVER}")
        message = f"{self.path.name} is damaged or unfinished; its {len(self._rows)} readable messages are used"
        note(self.events, Event(code="truncated", message=message))

    def _describe(self) -> None:
        rows = self._rows
        assert rows is not None
        self.channels = list(rows.channels.values())
        self.start_ns, self.end_ns = rows.span_ns
        if rows.unusable:
            message = f"{self.path.name}: {rows.unusable} rows have no stamp or no topic, and are left out"
            note(self.events, Event(code="bad-message", message=message, count=rows.unusable))

    def close(self) -> None:
        """Release the file."""
        if self._rows is not None:
            self._rows.close()
        if self._copy is not None:
            self._copy.close()
        self._rows, self._copy = None, None

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[RawBytes]:
        """Yield the messages of ``topics`` received at or after ``start_ns``, in that order."""
        rows = self._rows
        if rows is None:
            return
        lost = 0
        for channel, time_ns, data in rows.messages(topics, start_ns):
            if data is None:
                lost += 1
            else:
                yield channel, time_ns, data
        if lost and self._copy is None:
            message = f"{self.path.name} is damaged: {lost} of its messages cannot be read; the others are used"
            note(self.events, Event(code="truncated", message=message))


class _Rows:
    """The tables of one database: its topics, and stamp and topic of every message, in the order of the stamps.

    Raises
    ------
    FormatError
        The tables are no plain tables, or there are too many topics.
    sqlite3.Error
        The table of topics is not whole.
    """

    def __init__(self, path: Path, named: Path, limits: ReadLimits) -> None:
        self._named, self.damage, self.unusable = named, "", 0
        # The stream may be read in another thread than the one that opened it, but never in two at once.
        self._db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False)
        try:
            self._db.text_factory = _text
            if sys.version_info >= (3, 11):
                self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.chunk)
            self._require_tables()
            types = self._topics(limits.topics)
            self._read_index(types, path.stat().st_size // _LEAST_ROW)
        except BaseException:
            self.close()
            raise

    def __len__(self) -> int:
        return len(self._stamps)

    def close(self) -> None:
        """Release the file."""
        self._db.close()

    def messages(self, topics: frozenset[str], start_ns: int) -> Iterator[tuple[Channel, int, memoryview | None]]:
        """Yield the messages of topics from a time on; None as the content of those that cannot be read."""
        wanted = [key for key, channel in self.channels.items() if channel.topic in topics]
        chosen = np.flatnonzero(np.isin(self._keys, wanted) & (self._stamps >= start_ns))
        for i in chosen.tolist():
            channel, time_ns = self.channels[int(self._keys[i])], int(self._stamps[i])
            try:
                found = self._db.execute("SELECT data FROM messages WHERE rowid = ?", (int(self._ids[i]),)).fetchone()
            except (sqlite3.Error, MemoryError):
                found = None
            whole = found is not None and isinstance(found[0], bytes)
            yield channel, time_ns, memoryview(found[0]) if whole and found is not None else None

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception [ns]."""
        return (int(self._stamps[0]), int(self._stamps[-1])) if len(self) else (0, 0)

    def _require_tables(self) -> None:
        found = dict(self._db.execute("SELECT name, sql FROM sqlite_master WHERE type IN ('table', 'view') LIMIT 1000"))
        missing = [name for name in TABLES if name not in found]
        if missing:
            raise FormatError(self._named, f"has no table {missing[0]}: no ROS 2 bag; check the file's name")
        for name in TABLES:
            sql = str(found[name] or "")
            if not sql.upper().split()[:2] == ["CREATE", "TABLE"] or " GENERATED " in f" {sql.upper()} ":
                raise FormatError(self._named, f"'{name}' is no plain table but computed, which no recorder writes")

    def _topics(self, max_topics: int) -> dict[int, tuple[str, str, str]]:
        rows = self._db.execute(
            f"SELECT id, name, type, serialization_format FROM topics LIMIT {max_topics + 1}"
        ).fetchall()
        if len(rows) > max_topics:
            raise FormatError(
                self._named, f"has more than {max_topics} topics, as no recording has: the file is damaged"
            )
        usable = [row for row in rows if isinstance(row[0], int) and all(isinstance(text, str) for text in row[1:3])]
        self.unusable += len(rows) - len(usable)
        return {key: (name, ros2_name(kind), _encoding(form)) for key, name, kind, form in usable}

    def _read_index(self, topics: dict[int, tuple[str, str, str]], max_rows: int) -> None:
        """Read which messages there are; not more than fit the file, for a damaged page may stand in its own branch."""
        ids, stamps, keys = array("q"), array("q"), array("q")
        try:
            for row, time_ns, key in self._db.execute(
                f"SELECT rowid, timestamp, topic_id FROM messages LIMIT {max_rows}"
            ):
                if key in topics and isinstance(time_ns, int) and 0 <= time_ns < MAX_NS:
                    ids.append(row)
                    stamps.append(time_ns)
                    keys.append(key)
                else:
                    self.unusable += 1
        except sqlite3.Error as error:
            self.damage = str(error)  # the rows in front of it are good
        order = np.argsort(np.array(stamps, dtype=np.int64), kind="stable")
        self._ids, self._stamps, self._keys = (np.array(x, dtype=np.int64)[order] for x in (ids, stamps, keys))
        counts = Counter(self._keys.tolist())
        self.channels = {
            key: Channel(topic=name, message_type=kind, encoding=encoding, count=counts[key])
            for key, (name, kind, encoding) in topics.items()
        }


def _text(content: bytes) -> str:
    return content.decode(errors="replace")


def _encoding(form: Any) -> str:  # noqa: ANN401 - whatever the column holds
    return str(form) if form else "cdr"
