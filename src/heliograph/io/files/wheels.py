"""Speeds of wheels or legs from a CSV beside a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from heliograph.data import WheelSpeeds
from heliograph.errors import FormatError
from heliograph.io.files.table import read_table

__all__ = ["FASTEST", "read_wheel_speeds"]

FASTEST = 100.0  # [m/s]


def read_wheel_speeds(path: Path | str) -> WheelSpeeds:
    """Read ``stamp`` (seconds or nanoseconds since 1970) and ``vx`` (forward), ``vy``, ``vz`` where measured [m/s].

    Raises
    ------
    FormatError
        The file is no such table, its stamps do not increase, or its speeds are none of a vehicle.
    """
    table = read_table(Path(path))
    stamps = table.stamps_ns("stamp", "stamp_ns", "time", "timestamp", "t")
    v = np.full((len(table), 3), np.nan)
    v[:, 0] = table.numbers("vx", "speed", "forward", "v")
    for k, names in ((1, ("vy", "left")), (2, ("vz", "up"))):
        if table.has(*names):
            v[:, k] = table.numbers(*names)
    if not len(stamps):
        raise FormatError(path, "holds no speed; give rows of stamp,vx")
    if (np.diff(stamps) <= 0).any():
        line = table.lines[int(np.flatnonzero(np.diff(stamps) <= 0)[0]) + 1]
        raise FormatError(path, f"line {line}: its stamp is not later than the one before; sort the rows, drop repeats")
    if np.nanmax(np.abs(v)) > FASTEST:
        raise FormatError(path, f"holds speeds of up to {np.nanmax(np.abs(v)):.0f} m/s: give metres a second")
    return WheelSpeeds(stamps_ns=stamps, v_body=v, received_ns=int(stamps[-1]))
