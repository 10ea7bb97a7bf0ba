"""Tables that grow by rows: ``scans.csv`` and the like."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from heliograph.io.files.rows import RowFile

__all__ = ["CsvWriter"]

Value = str | int | float | bool | np.generic | None


class CsvWriter:
    """Comma-separated file whose first line names the columns, written row by row.

    Parameters
    ----------
    path : Path or str
        File to create; an existing one is replaced.
    columns : sequence of str
        Column names, unique.
    at : int, optional
        Bytes of a file that is there: rows go on behind them [bytes].

    Raises
    ------
    OutputError
        The file cannot be created or written.

    Notes
    -----
    Floats are written with the fewest digits that read back to the same value; None and NaN become an empty cell, as
    spreadsheets and pandas expect; booleans become 0 and 1.
    """

    def __init__(self, path: Path | str, columns: Sequence[str], *, at: int | None = None) -> None:
        if len(set(columns)) != len(columns) or not columns:
            raise ValueError(f"column names must be unique and at least one: {list(columns)}")
        self.columns = tuple(columns)
        self._rows = RowFile(path, header=_line(self.columns), at=at)

    @property
    def path(self) -> Path:
        """The file."""
        return self._rows.path

    @property
    def size(self) -> int:
        """Bytes of the rows so far, all of them on the disk."""
        return self._rows.size

    def append(self, row: Mapping[str, Value] | Sequence[Value]) -> None:
        """Append one row: values by column name (a missing one is an empty cell) or in column order.

        Raises
        ------
        ValueError
            An unknown column, or the wrong number of values.
        """
        if isinstance(row, Mapping):
            unknown = set(row) - set(self.columns)
            if unknown:
                raise ValueError(f"unknown columns {sorted(unknown)}; the file has {list(self.columns)}")
            row = [row.get(name) for name in self.columns]
        if len(row) != len(self.columns):
            raise ValueError(f"{len(row)} values for {len(self.columns)} columns of {self.path.name}")
        self._rows.write(_line([_cell(value) for value in row]))

    def flush(self) -> None:
        """Hand all rows so far to the operating system."""
        self._rows.flush()

    def close(self) -> None:
        """Flush and release the file."""
        self._rows.close()

    def __enter__(self) -> CsvWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _line(cells: Sequence[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def _cell(value: Value) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or (isinstance(value, float) and value != value):
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return repr(value) if isinstance(value, float) else str(value)
