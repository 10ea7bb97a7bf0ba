"""A folder of PCD or PLY clouds, with an optional IMU table and mounting."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.clouds import CLOUD_SUFFIXES, read_cloud
from heliograph.io.files.extrinsic import read_extrinsic
from heliograph.io.files.imu_tables import ImuTable, read_imu_table
from heliograph.io.files.stamps import STAMP_FILES, is_number, parse_stamps
from heliograph.io.raw import RawCloud, RawImu, RawMessage, RawSource, TopicInfo

__all__ = ["open_cloud_folder"]

_CLOUDS, _IMU = "/points", "/imu"
_IMU_TABLES = ("imu.csv", "imu.txt", "imu_data.csv", "imu/data.csv", "imu/imu.csv", "imu0/data.csv")
_EXTRINSIC = "extrinsic.toml"
_SECONDS_AND_NANOSECONDS = re.compile(r"(\d{9,10})[_-](\d{9})")
_NUMBER = re.compile(r"\d+(\.\d+)?")
_ASSUMED_PERIOD_NS = 100_000_000
_SMALLEST_STAMP = 1e8  # smaller whole numbers in file names are counters, not times since 1970


def open_cloud_folder(paths: Sequence[Path]) -> RawSource | None:
    """Open a folder of clouds.

    Parameters
    ----------
    paths : sequence of Path
        One folder with ``.pcd`` or ``.ply`` files in it or in its only subfolder that has some; or those files.
        Beside them, or one folder up, may lie: the stamps (``times.txt``, ``timestamps.csv``: one row a cloud, in the
        order of names; else the file names are the stamps), the inertial samples (``imu.csv``, ``imu.txt``; see
        `heliograph.io.files.imu_tables`), the mounting (``extrinsic.toml``; see `heliograph.io.files.extrinsic`).

    Returns
    -------
    RawSource or None
        None if there are no clouds.

    Raises
    ------
    FormatError
        Stamps are missing while there is an IMU table, or do not fit the clouds.
    """
    clouds = _clouds_of(paths)
    return _CloudFolder(clouds) if clouds else None


def _clouds_of(paths: Sequence[Path]) -> list[Path]:
    if len(paths) == 1 and paths[0].is_dir():
        found = _clouds_in(paths[0])
        if found:
            return found
        inner = [clouds for folder in sorted(paths[0].iterdir()) if folder.is_dir() and (clouds := _clouds_in(folder))]
        return inner[0] if len(inner) == 1 else []
    if all(path.suffix.lower() in CLOUD_SUFFIXES and path.is_file() for path in paths):
        return sorted(paths, key=_natural)
    return []


def _clouds_in(folder: Path) -> list[Path]:
    return sorted((path for path in folder.iterdir() if path.suffix.lower() in CLOUD_SUFFIXES), key=_natural)


def _natural(path: Path) -> list[tuple[int, int | str]]:
    """Sort ``10.pcd`` after ``9.pcd``."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", path.stem) if part]


class _CloudFolder:
    def __init__(self, clouds: Sequence[Path]) -> None:
        self.events: list[Event] = []
        folder = clouds[0].parent
        self._beside = (folder, folder.resolve().parent)
        imu_path = self._find(_IMU_TABLES)
        self._clouds = list(zip(self._stamps(clouds, imu_path), clouds, strict=True))
        self._clouds.sort(key=lambda item: item[0])
        self._imu = None if imu_path is None else self._read_imu(imu_path)
        self.description = f"folder of {len(clouds)} {clouds[0].suffix[1:].upper()} clouds"
        topics = [TopicInfo(name=_CLOUDS, message_type=f"file/{clouds[0].suffix[1:]}", kind="lidar", count=len(clouds))]
        if self._imu is not None:
            topics.append(TopicInfo(name=_IMU, message_type="file/table", kind="imu", count=len(self._imu.stamps_ns)))
        self.topics = tuple(topics)

    def _find(self, names: Sequence[str]) -> Path | None:
        return next((path for folder in self._beside for name in names if (path := folder / name).is_file()), None)

    def _read_imu(self, path: Path) -> ImuTable:
        table = read_imu_table(path)
        self.events.append(Event(code="imu-columns", message=f"{path.name}: {table.evidence}", severity="info"))
        if table.bad_rows:
            message = f"{path.name}: {table.bad_rows} rows are incomplete or not numbers and are left out"
            self.events.append(Event(code="imu-bad-rows", message=message, count=table.bad_rows))
        return table

    def _stamps(self, clouds: Sequence[Path], imu_path: Path | None) -> list[int]:
        """Return a stamp for each cloud: from a list beside them, from their names, or assumed."""
        listed = self._find(STAMP_FILES)
        if listed is not None:
            return _listed_stamps(listed, clouds)
        named = _named_stamps(clouds)
        if named is not None:
            return named
        if imu_path is not None:
            raise FormatError(
                clouds[0].parent,
                f"has clouds without stamps beside {imu_path.name}; add times.txt with one stamp a cloud, or name the "
                "files by their stamps",
            )
        message = "the clouds have no stamps (no times.txt, names are no times); 10 Hz is assumed"
        self.events.append(Event(code="assumed-stamps", message=message))
        return [index * _ASSUMED_PERIOD_NS for index in range(len(clouds))]

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield clouds and inertial samples in the order of their stamps."""
        clouds = self._cloud_messages() if _CLOUDS in topics else iter(())
        samples = self._imu_messages() if _IMU in topics and self._imu is not None else iter(())
        yield from heapq.merge(clouds, samples, key=lambda message: message.received_ns)

    def _cloud_messages(self) -> Iterator[RawMessage]:
        for stamp_ns, path in self._clouds:
            try:
                cloud = read_cloud(path)
            except FormatError as error:
                event = Event(code="damaged-scan", message=f"{error}; the scan is left out", stamp_ns=stamp_ns)
                if event not in self.events:
                    self.events.append(event)
                continue
            columns: dict[str, NDArray[np.generic]] = {axis: cloud.points[:, i] for i, axis in enumerate("xyz")}
            if cloud.intensity is not None:
                columns["intensity"] = cloud.intensity
            columns.update(cloud.columns)
            yield RawCloud(
                topic=_CLOUDS,
                received_ns=stamp_ns,
                stamp_ns=stamp_ns,
                frame_id="lidar",
                columns=columns,
                layout=f"file/{path.suffix[1:].lower()}",
            )

    def _imu_messages(self) -> Iterator[RawMessage]:
        assert self._imu is not None
        rows = zip(self._imu.stamps_ns.tolist(), self._imu.gyro.tolist(), self._imu.accel.tolist(), strict=True)
        for stamp_ns, gyro, accel in rows:
            yield RawImu(
                topic=_IMU,
                received_ns=stamp_ns,
                stamp_ns=stamp_ns,
                frame_id="imu",
                gyro=(gyro[0], gyro[1], gyro[2]),
                accel=(accel[0], accel[1], accel[2]),
            )

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return the mounting from ``extrinsic.toml``, if it lies beside the clouds."""
        path = self._find((_EXTRINSIC,))
        if path is None:
            return None
        rig = read_extrinsic(path)
        return rig.T_imu_lidar, f"{path.name} beside the clouds"

    def close(self) -> None:
        """Nothing stays open between iterations."""


def _listed_stamps(path: Path, clouds: Sequence[Path]) -> list[int]:
    """Return the stamps of a list with one row a cloud; a header and comments are skipped."""
    lines = [
        line.partition("#")[0].strip() for line in plain_file(path, TABLE).read_text(encoding="utf-8").splitlines()
    ]
    rows = [re.split(r"[,;\s]+", line) for line in lines if line]
    if rows and not any(is_number(word) for word in rows[0]):
        rows = rows[1:]
    if len(rows) != len(clouds):
        rows = _rows_by_name(path, rows, clouds)
    column = _stamp_column(rows)
    try:
        return [int(stamp) for stamp in parse_stamps([row[column] for row in rows])[0]]
    except (ValueError, IndexError) as error:
        raise FormatError(path, f"does not hold one stamp a row: {error}") from None


def _rows_by_name(path: Path, rows: list[list[str]], clouds: Sequence[Path]) -> list[list[str]]:
    """Return the rows that the clouds' names number, from 0: of a longer recording, some clouds may have been kept."""
    numbers = [int(cloud.stem) if cloud.stem.isdecimal() else -1 for cloud in clouds]
    if min(numbers) < 0 or max(numbers) >= len(rows):
        raise FormatError(
            path,
            f"has {len(rows)} stamps for {len(clouds)} clouds; give one row a cloud, or name each cloud by the number "
            "of its row, from 0",
        )
    return [rows[number] for number in numbers]


def _stamp_column(rows: Sequence[Sequence[str]]) -> int:
    """Return the first column that is not the row's own number: ``index,stamp`` tables exist."""
    if min(len(row) for row in rows) < 2:
        return 0
    first = [row[0] for row in rows]
    if not is_number(first[0]):
        return 1
    numbers = [float(word) for word in first if is_number(word)]
    return 1 if numbers == [numbers[0] + index for index in range(len(rows))] else 0


def _named_stamps(clouds: Sequence[Path]) -> list[int] | None:
    """Return the stamps that are the file names; None if they are no times."""
    pairs = [_SECONDS_AND_NANOSECONDS.fullmatch(path.stem) for path in clouds]
    if all(pairs):
        return [int(pair[1]) * 1_000_000_000 + int(pair[2]) for pair in pairs if pair]
    names = [path.stem for path in clouds]
    if not all(_NUMBER.fullmatch(name) for name in names):
        return None
    counters = max(float(name) for name in names) < _SMALLEST_STAMP and not all("." in name for name in names)
    return None if counters else [int(stamp) for stamp in parse_stamps(names)[0]]
