"""A plan of edits that a person makes of a run: TOML, read as a whole before anything is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.arrays import Array, Mask, Points, freeze
from heliograph.errors import FormatError, closest
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.guard.toml import parse_toml

__all__ = ["EDITS", "RemovedBox", "RunEdits", "read_edits"]

EDITS = "edits.toml"
"""Name of the plan in a run's folder."""

_TABLES = {
    "remove_box": ("low", "high"),
    "add_loop": ("query", "match"),
    "forbid_loop": ("query", "match"),
    "drop_session": ("name",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovedBox:
    """A box whose points are left out of the map.

    Parameters
    ----------
    low, high : (3,) float64
        Its ends, map frame [m].
    """

    low: Array
    high: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEdits:
    """What a plan asks for.

    Parameters
    ----------
    boxes : tuple of RemovedBox
    added, forbidden : tuple of (int, int)
        Loops by the numbers of their two keyframes, the later one first.
    dropped : tuple of str
        Sessions of merged runs that are left out.
    """

    boxes: tuple[RemovedBox, ...] = ()
    added: tuple[tuple[int, int], ...] = ()
    forbidden: tuple[tuple[int, int], ...] = ()
    dropped: tuple[str, ...] = ()

    def kept(self, points_map: Points) -> Mask:
        """Return which points (N, 3) of the map frame lie in no box."""
        out = np.ones(len(points_map), dtype=bool)
        for box in self.boxes:
            out &= ~((points_map >= box.low) & (points_map <= box.high)).all(axis=1)
        return out


def read_edits(path: Path | str) -> RunEdits:
    """Read a plan.

    Raises
    ------
    FormatError
        It is not there, no TOML, or asks for something that there is not; the message names the table.
    """
    path = Path(path)
    try:
        tables = parse_toml(plain_file(path, SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(path, f"is no plan of edits ({error})") from error
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in _TABLES}
    for name, value in tables.items():
        if name not in _TABLES:
            raise FormatError(path, f"[[{name}]] is no edit; there are {', '.join(_TABLES)}{closest(name, _TABLES)}")
        if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
            raise FormatError(path, f"write [[{name}]] with two brackets: there may be several")
        for number, row in enumerate(value, 1):
            if sorted(row) != sorted(_TABLES[name]):
                raise FormatError(path, f"[[{name}]] number {number} needs {' and '.join(_TABLES[name])}, and no more")
        rows[name] = value
    return RunEdits(
        boxes=tuple(_box(path, row) for row in rows["remove_box"]),
        added=tuple(_pair(path, "add_loop", row) for row in rows["add_loop"]),
        forbidden=tuple(_pair(path, "forbid_loop", row) for row in rows["forbid_loop"]),
        dropped=tuple(str(row["name"]) for row in rows["drop_session"]),
    )


def _box(path: Path, row: dict[str, Any]) -> RemovedBox:
    try:
        low, high = (np.array(row[name], dtype=np.float64) for name in ("low", "high"))
    except (TypeError, ValueError, OverflowError):
        low = high = np.zeros(0)
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all() or not np.isfinite([*low, *high]).all():
        raise FormatError(path, "[[remove_box]] needs three numbers for low, and three greater ones for high [m]")
    return RemovedBox(low=low, high=high)


def _pair(path: Path, name: str, row: dict[str, Any]) -> tuple[int, int]:
    pair = (row["query"], row["match"])
    if not all(type(number) is int and number >= 0 for number in pair) or pair[0] == pair[1]:
        raise FormatError(path, f"[[{name}]] needs the numbers of two keyframes, not {pair[0]!r} and {pair[1]!r}")
    return max(pair), min(pair)
