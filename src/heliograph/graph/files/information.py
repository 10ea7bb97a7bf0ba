"""Information matrices as files state them: which are none, and what may stand in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliograph.arrays import Array, Indices
from heliograph.errors import FormatError
from heliograph.graph.files.tables import Table

__all__ = ["indefinite", "repaired"]


_PSD_TOLERANCE = 1e-9  # of the largest eigenvalue: what rounding the file's digits may do to a singular matrix


def indefinite(information: Array) -> tuple[Indices, Array]:
    """Return which of (N, d, d) are not positive semi-definite, (M,), and their eigenvalues, ascending, (M, d)."""
    n, d = information.shape[:2]
    if not n or not d:
        return np.zeros(0, dtype=np.int64), np.zeros((0, d))
    # An LDL' factorisation of all at once clears nearly every matrix; only what it doubts is worth an eigenvalue.
    rest = np.array(information)
    scale = np.einsum("nii->ni", information).max(axis=1)
    doubtful = np.zeros(n, dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(d):
            pivot = rest[:, k, k]
            doubtful |= ~(pivot > _PSD_TOLERANCE * scale)
            column = rest[:, k + 1 :, k]
            safe = np.where(pivot > 0.0, pivot, 1.0)
            rest[:, k + 1 :, k + 1 :] -= column[:, :, None] * (column / safe[:, None])[:, None, :]
    suspects = np.flatnonzero(doubtful)
    values = np.linalg.eigvalsh(information[suspects])
    wrong = values[:, 0] < -_PSD_TOLERANCE * np.abs(values).max(axis=1)
    return suspects[wrong], values[wrong]


def repaired(path: Path, tables: Sequence[Table], repair: str) -> tuple[list[Table], list[str]]:
    """Return the tables with every information matrix positive semi-definite, and what was done to that end.

    Parameters
    ----------
    path : Path
        The file, for messages.
    tables : sequence of Table
        As read.
    repair : str
        ``clamp`` sets negative eigenvalues to zero, ``skip`` leaves the rows out, an empty string is an error.

    Raises
    ------
    FormatError
        Some matrices are not positive semi-definite and `repair` is empty; the message counts them.
    """
    found = [indefinite(table.information) for table in tables]
    bad = sum(len(rows) for rows, _ in found)
    if not bad:
        return list(tables), []
    if not repair:
        raise FormatError(path, _complaint(tables, found, bad))
    out = []
    for table, (rows, _) in zip(tables, found, strict=True):
        if repair == "skip":
            kept = np.setdiff1d(np.arange(len(table)), rows)
            if len(kept):
                out.append(table.rows(kept) if len(rows) else table)
            continue
        information = table.information
        if len(rows):
            values, vectors = np.linalg.eigh(information[rows])
            information = information.copy()
            information[rows] = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0.0), vectors)
        out.append(replace(table, information=information))
    total = sum(len(table) for table in tables if table.kind.information)
    done = "left out with their edges" if repair == "skip" else "clamped: their negative eigenvalues count as zero"
    return out, [f"{bad} of {total} information matrices are not positive semi-definite and were {done}"]


def _complaint(tables: Sequence[Table], found: list[tuple[Indices, Array]], bad: int) -> str:
    some = [k for k, (rows, _) in enumerate(found) if len(rows)]
    line, first = min((int(tables[k].line[found[k][0]].min()), k) for k in some)
    table, (rows, values) = tables[first], found[first]
    row = int(np.argmin(table.line[rows]))
    where = (
        f"line {line}: the information matrix of {table.kind.tag} is not positive semi-definite: its smallest "
        f"eigenvalue is {values[row, 0]:.3g}, its largest {values[row, -1]:.3g}"
    )
    if bad == 1:
        return f"{where}; correct it, remove the line, or read with repair_information (--repair-information clamp)"
    total = sum(len(t) for t in tables if t.kind.information)
    return (
        f"{where}; so are {bad} of the {total} in the file: correct them, or read with repair_information "
        "(--repair-information clamp or skip)"
    )
