"""Keyframes on disk: a journal and one file a keyframe, valid however the writing ended."""

from __future__ import annotations

import io
import json
import math
import os
import zlib
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from heliograph.arrays import Array, Stamps
from heliograph.atomic import output_errors
from heliograph.data import ImuBatch, Keyframe
from heliograph.errors import DataError, FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.guard.limits import MAX_NS
from heliograph.guard.npz import read_npz
from heliograph.snapshots import settle

__all__ = ["KeyframeStore"]

_JOURNAL, _FORMAT, _VERSION = "journal.jsonl", "heliograph keyframes", 1
_CACHED = 64  # keyframes held in memory
_LARGEST = 1 << 30  # bytes that one keyframe may claim: 60 million points
_NUMBERS = {
    "T_odom_imu": (4, 4),
    "v_odom": (3,),
    "gyro_bias": (3,),
    "accel_bias": (3,),
    "g_odom": (3,),
    "step_covariance": (6, 6),
    "lidar_information": (6, 6),
}


@dataclass(frozen=True, slots=True)
class _Entry:
    """One line of the journal."""

    index: int
    stamp_ns: int
    file: str
    size: int
    crc32: int


class KeyframeStore:
    """An append-only sequence of keyframes in a folder.

    Each keyframe is a file of its own, which is written before the journal names it. A line of the journal that is
    torn, or names a file that is not whole, ends the store: what stands before it is complete.

    Parameters
    ----------
    path : Path
        The folder.
    entries : sequence
        What `open` found.

    Examples
    --------
    >>> store = KeyframeStore.create(Path("run/keyframes"))
    >>> store.append(keyframe)
    >>> KeyframeStore.open(Path("run/keyframes"))[0].points_imu
    """

    def __init__(self, path: Path, entries: list[_Entry]) -> None:
        self.path = path
        self._entries = entries
        self._cache: OrderedDict[int, Keyframe] = OrderedDict()
        self._journal: IO[str] | None = None
        self._settled = len(entries)

    @classmethod
    def create(cls, path: Path | str) -> KeyframeStore:
        """Begin an empty store; one that stands there is replaced.

        Raises
        ------
        OutputError
            The folder cannot be made or written.
        """
        path = Path(path)
        with output_errors(path):
            path.mkdir(parents=True, exist_ok=True)
            (path / _JOURNAL).write_text(json.dumps({"format": _FORMAT, "version": _VERSION}) + "\n", encoding="utf-8")
            for file in path.glob("[0-9]*.npz"):
                file.unlink()
        return cls(path, [])

    @classmethod
    def open(cls, path: Path | str) -> KeyframeStore:
        """Open a store that a run left, to read it or to append to it.

        Raises
        ------
        FormatError
            There is none, or a later version wrote it.
        """
        path = Path(path)
        try:
            content = plain_file(path / _JOURNAL, TABLE).read_bytes()
        except OSError as error:
            raise FormatError(path, f"holds no keyframes ({error.strerror}); name the keyframes of a run") from error
        lines = content.split(b"\n")[:-1]  # what stands behind the last newline is torn
        head = _json(lines[0]) if lines else None
        if not isinstance(head, dict) or head.get("format") != _FORMAT:
            raise FormatError(path / _JOURNAL, "no journal of keyframes; name the keyframes of a run")
        if head.get("version") != _VERSION:
            raise FormatError(
                path / _JOURNAL, f"version {head.get('version')!r} of the store; this Heliograph reads {_VERSION}"
            )
        entries = list(_whole_entries(path, lines[1:]))
        return cls(path, _without_torn_end(path, entries))

    @classmethod
    def cut(cls, path: Path | str, keyframes: int) -> KeyframeStore:
        """Open a store that a run left as it was when it had ``keyframes``; later ones are taken out.

        Raises
        ------
        FormatError
            It does not hold as many, or not whole.
        OutputError
            The journal cannot be written.
        """
        store = cls.open(path)
        if len(store) < keyframes:
            raise FormatError(
                store.path, f"holds {len(store)} keyframes whole, the run had {keyframes}; run anew with --overwrite"
            )
        store._entries = store._entries[:keyframes]
        with output_errors(store.path):
            store._journal = store._opened_journal()
            for file in store.path.glob("[0-9]*.npz"):
                if file.stem.isdigit() and int(file.stem) >= keyframes:
                    file.unlink()
        return store

    def settle(self) -> None:
        """Have the operating system put on the disk itself what was appended since it last did."""
        with output_errors(self.path):
            for entry in self._entries[self._settled :]:
                settle(self.path / entry.file)
            if self._journal is not None:
                os.fsync(self._journal.fileno())
        settle(self.path)
        self._settled = len(self._entries)

    def append(self, keyframe: Keyframe) -> None:
        """Write the next keyframe.

        Raises
        ------
        DataError
            Its number is not the next one, or its stamp is not later than the last one.
        OutputError
            It cannot be written; the store is as it was.
        """
        if keyframe.index != len(self):
            raise DataError(f"keyframe {keyframe.index} does not follow {len(self) - 1}; keyframes are numbered from 0")
        if self._entries and keyframe.stamp_ns <= self._entries[-1].stamp_ns:
            raise DataError(f"keyframe {keyframe.index} is not later than the one before it")
        content = _packed(keyframe)
        entry = _Entry(
            keyframe.index, keyframe.stamp_ns, f"{keyframe.index:06d}.npz", len(content), zlib.crc32(content)
        )
        with output_errors(self.path):
            (self.path / entry.file).write_bytes(content)
            if self._journal is None:
                self._journal = self._opened_journal()
            self._journal.write(json.dumps({f.name: getattr(entry, f.name) for f in fields(entry)}) + "\n")
            self._journal.flush()
        self._entries.append(entry)
        self._remember(keyframe)

    def close(self) -> None:
        """Release the journal; reading goes on, and `append` opens it again."""
        if self._journal is not None:
            journal, self._journal = self._journal, None
            with output_errors(self.path):
                journal.close()

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> Keyframe:
        """Return a keyframe, from memory or from its file.

        Raises
        ------
        IndexError
            There is none of that number.
        FormatError
            Its file was changed since the store was opened.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"keyframe {index} of {len(self)}")
        if index in self._cache:
            self._cache.move_to_end(index)
            return self._cache[index]
        entry = self._entries[index]
        file = self.path / entry.file
        try:
            content = plain_file(file, TABLE).read_bytes()
        except OSError as error:
            raise FormatError(file, f"cannot be read ({error.strerror}); the store is damaged") from error
        if zlib.crc32(content) != entry.crc32:
            raise FormatError(file, "does not agree with the journal; the store is damaged")
        keyframe = _unpacked(file, content)
        self._remember(keyframe)
        return keyframe

    def __iter__(self) -> Iterator[Keyframe]:
        return (self[index] for index in range(len(self)))

    def points(self, index: int) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Return a keyframe's points (N, 3) float32, imu frame [m]."""
        return self[index].points_imu

    @property
    def stamps_ns(self) -> Stamps:
        """Times of all keyframes, (K,) [ns]."""
        return np.array([entry.stamp_ns for entry in self._entries], dtype=np.int64)

    def T_odom_imu(self, index: int) -> Array:
        """Return a keyframe's pose (4, 4) as the odometry gave it."""
        return self[index].T_odom_imu

    def _remember(self, keyframe: Keyframe) -> None:
        self._cache[keyframe.index] = keyframe
        self._cache.move_to_end(keyframe.index)
        while len(self._cache) > _CACHED:
            self._cache.popitem(last=False)

    def _opened_journal(self) -> IO[str]:
        """Open the journal behind its last whole line: what an earlier run left torn must not stay in between."""
        path = self.path / _JOURNAL
        lines = plain_file(path, TABLE).read_bytes().split(b"\n")[: 1 + len(self)]
        journal = path.open("r+", encoding="utf-8", newline="\n")
        journal.truncate(sum(len(line) + 1 for line in lines))
        journal.seek(0, io.SEEK_END)
        return journal


def _json(line: bytes) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _whole_entries(path: Path, lines: list[bytes]) -> Iterator[_Entry]:
    last = -MAX_NS
    for index, line in enumerate(lines):
        found = _json(line)
        names = [f.name for f in fields(_Entry)]
        if not isinstance(found, dict) or sorted(found) != sorted(names):
            return
        entry = _Entry(*(found[name] for name in names))
        numbers = (entry.index, entry.stamp_ns, entry.size, entry.crc32)
        if not all(type(number) is int for number in numbers) or entry.file != f"{index:06d}.npz":
            return
        file = path / entry.file
        if entry.index != index or not last < entry.stamp_ns < MAX_NS or entry.size > _LARGEST:
            return
        if not file.is_file() or file.stat().st_size != entry.size:
            return
        last = entry.stamp_ns
        yield entry


def _without_torn_end(path: Path, entries: list[_Entry]) -> list[_Entry]:
    """Leave out the last files that are not what was written: a power loss leaves some that hold zeros."""
    while entries and zlib.crc32(plain_file(path / entries[-1].file, TABLE).read_bytes()) != entries[-1].crc32:
        entries.pop()
    return entries


def _packed(keyframe: Keyframe) -> bytes:
    arrays: dict[str, Any] = {
        "numbers": np.concatenate([getattr(keyframe, name).ravel() for name in _NUMBERS]),
        "integers": np.array([keyframe.index, keyframe.stamp_ns, keyframe.imu.received_ns], dtype=np.int64),
        "points_imu": keyframe.points_imu,
        "imu_stamps_ns": keyframe.imu.stamps_ns,
        "imu_samples": np.hstack([keyframe.imu.gyro, keyframe.imu.accel]),
        "imu_frame_id": keyframe.imu.frame_id,
    }
    if keyframe.intensity is not None:
        arrays["intensity"] = keyframe.intensity
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _unpacked(file: Path, content: bytes) -> Keyframe:
    try:
        arrays = read_npz(io.BytesIO(content))
        index, stamp_ns, received_ns = arrays["integers"].tolist()
        samples = arrays["imu_samples"]
        imu = ImuBatch(
            stamps_ns=arrays["imu_stamps_ns"],
            gyro=np.ascontiguousarray(samples[:, :3]),
            accel=np.ascontiguousarray(samples[:, 3:]),
            received_ns=received_ns,
            frame_id=str(arrays["imu_frame_id"]),
        )
        parts = np.split(arrays["numbers"], np.cumsum([math.prod(shape) for shape in _NUMBERS.values()])[:-1])
        return Keyframe(
            index=index,
            stamp_ns=stamp_ns,
            **{name: part.reshape(_NUMBERS[name]) for name, part in zip(_NUMBERS, parts, strict=True)},
            points_imu=arrays["points_imu"],
            intensity=arrays.get("intensity"),
            imu=imu,
        )
    except (KeyError, ValueError, TypeError, IndexError, DataError) as error:
        raise FormatError(file, f"is no keyframe ({error}); the store is damaged") from error
