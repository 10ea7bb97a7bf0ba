"""Rows of one kind of a pose-graph file, stacked; read, checked and written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliograph import _core
from heliograph.arrays import Array, Indices, freeze
from heliograph.errors import FormatError
from heliograph.graph.files.row_kinds import KINDS, RowKind, matrices_of, numbers_of

__all__ = ["Table", "as_kind", "parse_tables", "written"]


_EXACT = 2.0**53  # up to here a double holds every whole number
_ARRAYS = ("ids", "numbers", "information", "parameters", "line")
_NO_INTEGER = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """All rows of one kind, in the order of the file.

    Parameters
    ----------
    kind : RowKind
        What they are.
    ids : (N, 1) or (N, 2) int64
        The variables they name, in the direction of the file.
    numbers : (N, kind.numbers) float64
        Their values to the bit as in the file: angles unwrapped, quaternions not normalised.
    information : (N, d, d) float64
        Inverse covariances, rotation first; (N, 0, 0) where the kind has none.
    parameters : (N, kind.parameters) int64
        Numbers of sensor offsets.
    line : (N,) int64
        Line in the file, 0 for rows that are in none; rows are written in its order.
    """

    kind: RowKind
    ids: Indices
    numbers: Array
    information: Array
    parameters: Indices
    line: Indices

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))
        freeze(self)

    def __len__(self) -> int:
        return len(self.ids)

    def rows(self, chosen: Indices) -> Table:
        """Return a table of some of the rows, by index."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in _ARRAYS})

    @property
    def matrices(self) -> Array:
        """The rows' poses as homogeneous matrices, (N, k, k); for poses, priors, relative poses and angles."""
        return matrices_of(self.kind, self.numbers)

    def text(self) -> tuple[bytes, Indices]:
        """Return the rows as lines and the offsets (N + 1) between them."""
        kind = self.kind
        integers = np.concatenate([self.ids, self.parameters], axis=1)
        flat = [self.information[:, a, b] for a, b in kind.information]
        numbers = np.column_stack([self.numbers, *flat])
        data, offsets = _core.format_rows(kind.tag, np.ascontiguousarray(integers), np.ascontiguousarray(numbers))
        return data, offsets

    @staticmethod
    def of(
        kind: RowKind, ids: Indices, numbers: Array, information: Array | None = None, line: Indices | None = None
    ) -> Table:
        """Return a table of rows that come from no file, or from other lines."""
        n = len(ids)
        return Table(
            kind=kind,
            ids=np.asarray(ids, dtype=np.int64).reshape(n, kind.ids),
            numbers=np.asarray(numbers, dtype=np.float64),
            information=np.zeros((n, 0, 0)) if information is None else np.asarray(information, dtype=np.float64),
            parameters=np.zeros((n, kind.parameters), dtype=np.int64),
            line=np.zeros(n, dtype=np.int64) if line is None else line,
        )


def as_kind(table: Table, tag: str) -> Table:
    """Return a table of poses or relative poses in another format's words; unchanged if it is of that kind already."""
    kind = KINDS[tag]
    if kind.tag == table.kind.tag:
        return table
    same = kind.layout == table.kind.layout
    return replace(table, kind=kind, numbers=table.numbers if same else numbers_of(kind, table.matrices))


def written(tables: Iterable[Table], others: Iterable[tuple[int, str]] = ()) -> bytes:
    """Return the text of a file: every table's rows and the other (line, text) in the order of their lines.

    Rows without a line come first, tables one after the other.
    """
    chunks, lines = [], []
    for table in tables:
        chunks.append(table.text())
        lines.append(table.line)
    for line, text in others:
        data = text.encode() + b"\n"
        chunks.append((data, np.array([0, len(data)])))
        lines.append(np.array([line]))
    if not chunks:
        return b""
    source = np.repeat(np.arange(len(chunks)), [len(x) for x in lines])
    row = np.concatenate([np.arange(len(x)) for x in lines])
    order = np.argsort(np.concatenate(lines), kind="stable")
    source, row = source[order], row[order]
    # Rows that follow each other in one table are copied together.
    starts = np.flatnonzero(np.r_[True, (np.diff(source) != 0) | (np.diff(row) != 1)])
    ends = np.r_[starts[1:], len(row)] - 1
    spans = zip(source[starts].tolist(), row[starts].tolist(), row[ends].tolist(), strict=True)
    return b"".join(chunks[s][0][chunks[s][1][a] : chunks[s][1][b + 1]] for s, a, b in spans)


def parse_tables(path: Path, data: bytes, *, identity: bool = False) -> tuple[list[Table], list[tuple[int, str]]]:
    """Return the tables of a file's text and the (line, text) of comments and of lines whose tag is none of `KINDS`.

    Parameters
    ----------
    path : Path
        The file, for messages.
    data : bytes
        Its text.
    identity : bool
        Edges without an information matrix have that of a unit sigma.

    Raises
    ------
    FormatError
        A line is truncated or too long, or holds a word that is no number, NaN, an id that is no integer, or a zero
        quaternion. Names the line.
    """
    tags = list(KINDS)
    tag, line, span, integers, first, numbers, bad = _core.read_rows(data, tags)
    if bad[0]:
        word = data[bad[1] : bad[2]].decode(errors="replace")
        raise FormatError(path, f"line {bad[0]}: '{word[:40]}' is not a number; correct or remove the line")
    tables = []
    for index, name in enumerate(tags):
        rows = np.flatnonzero(tag == index)
        if len(rows):
            count = first[rows + 1] - first[rows]
            for kind, mine in _variants(path, KINDS[name], count, line[rows], identity=identity):
                chosen = rows[mine]
                values = numbers[first[chosen][:, None] + np.arange(kind.words)]
                tables.append(_table(path, kind, line[chosen], integers[chosen], values, KINDS[name]))
    tables.sort(key=lambda table: int(table.line[0]))
    others = [
        (int(line[k]), data[span[k, 0] : span[k, 1]].decode(errors="replace")) for k in np.flatnonzero(tag < 0).tolist()
    ]
    return tables, others


def _variants(
    path: Path, kind: RowKind, count: Indices, line: Indices, *, identity: bool
) -> list[tuple[RowKind, Indices]]:
    """Return the kinds that rows of one tag are of by their numbers of words, and the rows of each."""
    kinds = [kind]
    if kind.layout == "plane" and not kind.information:
        kinds.append(replace(kind, layout="coloured_plane"))
    bare = replace(kind, information=()) if kind.information else None
    if bare is not None and identity:
        kinds.append(bare)
    out, left = [], np.ones(len(count), dtype=bool)
    for one in kinds:
        mine = count == one.words
        left &= ~mine
        if mine.any():
            out.append((one, np.flatnonzero(mine)))
    if left.any():
        k = int(np.argmax(left))
        if bare is not None and count[k] == bare.words:
            remedy = "complete it, or read with missing_information (--missing-information identity)"
            fault = f"it has no information: {remedy}"
        else:
            fault = ("the line is cut off" if count[k] < kind.words else "it has too many") + ": complete or remove it"
        raise FormatError(
            path,
            f"line {line[k]}: {kind.tag} has {count[k]} numbers after its tag, expected {kind.words} "
            f"({kind.describe()}); {fault}",
        )
    return out


def _table(path: Path, kind: RowKind, line: Indices, integers: Indices, values: Array, full: RowKind) -> Table:
    """Return the table of one kind from the numbers of its rows; `full` is the kind with its information."""
    if not np.isfinite(values).all():
        k = int(np.argmax(~np.isfinite(values).all(axis=1)))
        raise FormatError(path, f"line {line[k]}: {kind.tag} holds NaN or infinity; correct or remove the line")
    ids = integers[:, : kind.ids]
    if (ids == _NO_INTEGER).any():
        k = int(np.argmax((ids == _NO_INTEGER).any(axis=1)))
        raise FormatError(path, f"line {line[k]}: an id of {kind.tag} is not a whole number of 64 bits; renumber it")
    start = kind.ids + kind.parameters
    parameters = values[:, kind.ids : start]
    if ((np.abs(parameters) > _EXACT) | (parameters % 1.0 != 0.0)).any():
        raise FormatError(path, f"line {line[0]} or a later one: an offset's id of {kind.tag} is not a whole number")
    if full.information and not kind.information:
        kind, information = full, np.tile(np.eye(full.rows), (len(values), 1, 1))
    else:
        information = _information(kind, values[:, start + kind.numbers :])
    table = Table(
        kind=kind,
        ids=ids,
        numbers=values[:, start : start + kind.numbers],
        information=information,
        parameters=parameters.astype(np.int64),
        line=line,
    )
    _check(path, table)
    return table


def _information(kind: RowKind, flat: Array) -> Array:
    """Return (N, d, d) matrices, rotation first, from their numbers in the order of the file."""
    matrix = np.zeros((len(flat), kind.rows, kind.rows))
    if kind.form == "root":
        for k, (a, b) in enumerate(kind.information):  # S in our order: its rows may stand in any, so they turn too
            matrix[:, a, b] = flat[:, k]
        return np.asarray(np.swapaxes(matrix, 1, 2) @ matrix)
    for k, (a, b) in enumerate(kind.information):
        matrix[:, a, b] = matrix[:, b, a] = flat[:, k]
    return matrix


def _check(path: Path, table: Table) -> None:
    kind = table.kind
    if kind.layout == "quaternion":
        norm = np.linalg.norm(table.numbers[:, 3:], axis=1)
        if (norm < 1e-150).any():
            k = int(np.argmax(norm < 1e-150))
            raise FormatError(
                path, f"line {table.line[k]}: the quaternion of {kind.tag} is zero; no rotation is 0 0 0 1"
            )
    for first, last in {"plane": ((0, 3),), "coloured_plane": ((0, 3),), "directions": ((0, 3), (3, 6))}.get(
        kind.layout, ()
    ):
        none = ~(np.linalg.norm(table.numbers[:, first:last], axis=1) > 1e-150)
        if none.any():
            line = table.line[int(np.argmax(none))]
            raise FormatError(path, f"line {line}: a direction of {kind.tag} has no length; correct or remove the line")
    numbered_apart = kind.form == "root" and kind.role == "landmark"  # iSAM counts poses and landmarks each from 0
    if kind.ids == 2 and not numbered_apart and (table.ids[:, 0] == table.ids[:, 1]).any():
        k = int(np.argmax(table.ids[:, 0] == table.ids[:, 1]))
        raise FormatError(
            path, f"line {table.line[k]}: {kind.tag} joins {table.ids[k, 0]} with itself; remove the line"
        )
