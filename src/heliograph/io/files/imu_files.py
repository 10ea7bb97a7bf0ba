"""A table of inertial samples alone: a recording without a LiDAR, such as an IMU left on a table overnight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event
from heliograph.io.files.imu_tables import ImuTable, read_imu_table
from heliograph.io.raw import RawImu, RawMessage, RawSource, TopicInfo

__all__ = ["ImuFile", "open_imu_file"]

_TOPIC = "/imu"
_SUFFIXES = (".csv", ".txt")


def open_imu_file(paths: Sequence[Path]) -> RawSource | None:
    """Open one ``.csv`` or ``.txt`` file with inertial samples; see `heliograph.io.files.imu_tables` for its columns.

    Returns
    -------
    RawSource or None
        None for anything else.

    Raises
    ------
    FormatError
        The columns are missing or not clear.
    """
    if len(paths) != 1 or not paths[0].is_file() or paths[0].suffix.lower() not in _SUFFIXES:
        return None
    return ImuFile(paths[0], read_imu_table(paths[0]))


class ImuFile:
    """The samples of a table as messages; received when they are stamped."""

    def __init__(self, path: Path, table: ImuTable) -> None:
        self._table = table
        self.description = f"IMU table {path.name}"
        count = len(table.stamps_ns)
        self.topics: tuple[TopicInfo, ...] = (
            TopicInfo(name=_TOPIC, message_type="file/table", kind="imu", count=count),
        )
        self.events = [Event(code="imu-columns", message=f"{path.name}: {table.evidence}", severity="info")]
        if table.bad_rows:
            message = f"{path.name}: {table.bad_rows} rows are incomplete or not numbers and are left out"
            self.events.append(Event(code="imu-bad-rows", message=message, count=table.bad_rows))

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Yield the samples in the order of the file."""
        if _TOPIC not in topics:
            return
        table = self._table
        for stamp_ns, w, f in zip(table.stamps_ns.tolist(), table.gyro.tolist(), table.accel.tolist(), strict=True):
            yield RawImu(
                topic=_TOPIC,
                received_ns=stamp_ns,
                stamp_ns=stamp_ns,
                frame_id="imu",
                gyro=(w[0], w[1], w[2]),
                accel=(f[0], f[1], f[2]),
            )

    def factory_T_imu_lidar(self) -> tuple[NDArray[np.float64], str] | None:
        """Return None: there is no LiDAR."""
        return None

    def close(self) -> None:
        """Nothing stays open."""
