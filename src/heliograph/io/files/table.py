"""Tables with a header, as people and their programs write them: commas, semicolons or tabs, points or commas."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.guard.limits import MAX_NS

__all__ = ["TextTable", "read_table"]

_SECONDS = 1e11  # a stamp above it is in milliseconds, microseconds or nanoseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """The cells of a file, as text.

    Parameters
    ----------
    path : Path
        For messages.
    names : tuple of str
        The columns' names, lower case.
    rows : tuple of tuple of str
    lines : tuple of int
        Line of each row, from 1.
    decimal_comma : bool
        Whether commas are points.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    decimal_comma: bool

    def __len__(self) -> int:
        return len(self.rows)

    def has(self, *names: str) -> str:
        """Return the first of these names that is a column, or nothing."""
        return next((name for name in names if name in self.names), "")

    def words(self, *names: str) -> list[str] | None:
        """Return a column's text, or None where there is no such column."""
        name = self.has(*names)
        return [row[self.names.index(name)] for row in self.rows] if name else None

    def numbers(self, *names: str) -> NDArray[np.float64]:
        """Return a column (N,) of numbers; an empty cell is NaN.

        Raises
        ------
        FormatError
            There is no such column, or a cell is no number; the message names the line.
        """
        name = self.has(*names)
        if not name:
            raise FormatError(self.path, f"has no column {names[0]} (its columns: {', '.join(self.names)})")
        column, at = np.empty(len(self.rows)), self.names.index(name)
        for k, (row, line) in enumerate(zip(self.rows, self.lines, strict=True)):
            text = row[at].strip().replace(",", ".") if self.decimal_comma else row[at].strip()
            try:
                column[k] = float(text) if text else np.nan
            except ValueError:
                raise FormatError(self.path, f"line {line}: {name} is '{row[at]}', which is no number") from None
        return column

    def stamps_ns(self, *names: str) -> NDArray[np.int64]:
        """Return a column (N,) of times in ns: seconds, or what their size says they are; digits are kept.

        Raises
        ------
        FormatError
            As `numbers`, or a time is missing.
        """
        values = self.numbers(*names)
        texts = self.words(*names) or []
        if not np.isfinite(values).all():
            line = self.lines[int(np.flatnonzero(~np.isfinite(values))[0])]
            raise FormatError(self.path, f"line {line} has no {self.has(*names)}")
        size = float(np.median(np.abs(values))) if len(values) else 0.0
        scale = next((s for limit, s in ((1e17, 1), (1e14, 10**3), (_SECONDS, 10**6)) if size > limit), 10**9)
        if (beyond := np.abs(values) > 2.0 * MAX_NS / scale).any():  # by so much that no integer is made of it
            raise FormatError(self.path, f"line {self.lines[int(np.argmax(beyond))]}: its time is beyond any clock's")
        stamps = [_scaled(text.strip().replace(",", "."), scale) for text in texts]
        for line, stamp in zip(self.lines, stamps, strict=True):
            if abs(stamp) > MAX_NS:
                raise FormatError(self.path, f"line {line}: its time is beyond any clock's")
        return np.array(stamps, dtype=np.int64)


def read_table(path: Path, text: str | None = None) -> TextTable:
    """Read a table.

    Parameters
    ----------
    path : Path
    text : str, optional
        Its content, where it was read already.

    Raises
    ------
    FormatError
        It cannot be read, has no header, or a row has another number of cells than the header.
    """
    if text is None:
        try:
            text = plain_file(path, TABLE).read_text(encoding="utf-8-sig", errors="replace")
        except OSError as error:
            raise FormatError(path, f"cannot be read: {error.strerror or error}") from error
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise FormatError(path, "is empty; give a header line and a row a measurement")
    header = numbered[0][1]
    mark = max(";\t,", key=header.count)
    names = tuple(name.strip().lower() for name in next(csv.reader([header], delimiter=mark)))
    if any(_number(name) for name in names):
        raise FormatError(path, f"has no header: its first line is '{header[:60]}'; name the columns in it")
    rows: list[tuple[str, ...]] = []
    for line, content in numbered[1:]:
        cells = tuple(next(csv.reader([content], delimiter=mark)))
        if len(cells) != len(names):
            why = (
                " (decimal commas? separate the columns by semicolons then)"
                if mark == "," and len(cells) > len(names)
                else ""
            )
            raise FormatError(path, f"line {line} has {len(cells)} cells, the header {len(names)}{why}")
        rows.append(cells)
    comma = mark != "," and any("," in cell for row in rows for cell in row)
    return TextTable(
        path=Path(path),
        names=names,
        rows=tuple(rows),
        lines=tuple(line for line, _ in numbered[1:]),
        decimal_comma=comma,
    )


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _scaled(text: str, scale: int) -> int:
    """Return a decimal number times a power of ten, to the last digit."""
    whole, _, part = text.partition(".")
    if scale == 1 or "e" in text.lower():
        return round(float(text) * scale) if "e" in text.lower() else int(whole)
    digits = len(str(scale)) - 1
    negative = whole.startswith("-")
    value = abs(int(whole or "0")) * scale + int((part[:digits]).ljust(digits, "0") or "0")
    return -value if negative else value
