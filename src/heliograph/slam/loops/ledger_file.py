"""``loops.csv``: one row a candidate, with everything that its decision was made from."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np

from heliograph.arrays import Array
from heliograph.atomic import atomic_path
from heliograph.config import LoopConfig
from heliograph.errors import FormatError
from heliograph.guard.files import TABLE, plain_file
from heliograph.registration import ResidualDistribution
from heliograph.slam.loops.ledger import Ledger, LedgerEntry
from heliograph.slam.loops.records import REASONS, LoopDecision, LoopEvidence, Verdict

__all__ = ["LOOP_COLUMNS", "read_ledger", "write_ledger"]

_RESIDUALS = tuple(ResidualDistribution.__slots__)
_FLOATS = ("score", "overlap_query", "overlap_match", "inliers", "weakest", "odom_mahalanobis", "lead",
           "shift_level", "shift_up", "doubt_level", "doubt_up", "blur_before", "blur_after")  # fmt: skip
_COUNTS = ("query", "match", "starts", "agreeing")
_POSES = ("T_match_query", "T_match_query_odom")
_COVARIANCES = ("covariance", "odom_covariance")
_UPPER = np.triu_indices(6)

LOOP_COLUMNS = (
    "number", "query", "match", "verdict", "reason", "numbers", "source", "status", *_FLOATS, "starts", "agreeing",
    *(f"residual_{name}" for name in _RESIDUALS), "blind", *_POSES, *_COVARIANCES,
)  # fmt: skip
"""Columns of ``loops.csv``. Poses are 12 numbers, the first three rows; covariances 21, the upper triangle by rows."""


def write_ledger(path: Path | str, ledger: Iterable[LedgerEntry]) -> None:
    """Write all entries, or nothing: numbers with as many digits as read back to the same.

    Parameters
    ----------
    path : Path or str
        The file; one that is there is replaced.
    ledger : Ledger or iterable of LedgerEntry

    Raises
    ------
    OutputError
        It cannot be written.
    """
    with atomic_path(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, LOOP_COLUMNS, lineterminator="\n")
        writer.writeheader()
        for entry in ledger:
            writer.writerow(_row(entry))


def read_ledger(path: Path | str, config: LoopConfig | None = None) -> Ledger:
    """Read a ledger back as it was written.

    Raises
    ------
    FormatError
        No such file, other columns, or a row that is no entry; the message names its line.
    """
    path = Path(path)
    try:
        with plain_file(path, TABLE).open(encoding="utf-8", newline="") as file:
            rows = csv.DictReader(file, strict=True)
            if tuple(rows.fieldnames or ()) != LOOP_COLUMNS:
                missing = [name for name in LOOP_COLUMNS if name not in (rows.fieldnames or ())]
                raise FormatError(path, f"it is no loops.csv of this version (columns missing: {missing or 'none'}); "
                                        "run the loops again")  # fmt: skip
            entries = [_entry(path, rows.line_num, len_before, row) for len_before, row in enumerate(rows)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(path, f"it cannot be read ({error})") from error
    return Ledger(config, entries)


def _row(entry: LedgerEntry) -> dict[str, object]:
    e, d = entry.evidence, entry.decision
    row: dict[str, object] = {name: getattr(e, name) for name in _COUNTS}
    row |= {name: _text(getattr(e, name)) for name in _FLOATS}
    row |= {f"residual_{name}": _text(getattr(e.residuals, name)) for name in _RESIDUALS}
    row |= {name: _numbers(getattr(e, name)[:3].ravel()) for name in _POSES}
    row |= {name: _numbers(getattr(e, name)[_UPPER]) for name in _COVARIANCES}
    row |= {"number": entry.number, "source": e.source, "status": e.status, "blind": "; ".join(e.blind)}
    named = " ".join(f"{name}={_text(value)}" for name, value in d.numbers.items())
    return row | {"verdict": d.verdict, "reason": d.reason, "numbers": named}


def _entry(path: Path, line: int, number: int, row: Mapping[str, str]) -> LedgerEntry:
    try:
        if int(row["number"]) != number:
            raise ValueError(f"number {row['number']} where {number} is due")
        if row["verdict"] not in get_args(Verdict) or row["reason"] not in REASONS:
            raise ValueError(f"unknown verdict or reason: {row['verdict']}, {row['reason']}")
        fields: dict[str, Any] = {name: row[name] for name in ("source", "status")}
        fields |= {name: int(row[name]) for name in _COUNTS}
        fields |= {name: float(row[name] or "nan") for name in _FLOATS}
        fields |= {name: _pose(row[name]) for name in _POSES}
        fields |= {name: _covariance(row[name]) for name in _COVARIANCES}
        residuals = ResidualDistribution(**{n: float(row[f"residual_{n}"] or "nan") for n in _RESIDUALS})
        blind = tuple(row["blind"].split("; ")) if row["blind"] else ()
        evidence = LoopEvidence(residuals=residuals, blind=blind, **fields)
        named = (item.split("=") for item in row["numbers"].split())
        numbers = {name: float(value or "nan") for name, value in named}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(path, f"line {line} is no loop ({error}); run the loops again") from error
    verdict: Verdict = row["verdict"]  # type: ignore[assignment]  # checked above
    decision = LoopDecision(verdict=verdict, reason=row["reason"], numbers=numbers)
    return LedgerEntry(number=number, evidence=evidence, decision=decision)


def _text(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _floats(text: str, count: int) -> Array:
    values = np.array([float(item) for item in text.split()])
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{len(values)} numbers where {count} finite ones are due")
    return values


def _pose(text: str) -> Array:
    return np.vstack([_floats(text, 12).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


def _covariance(text: str) -> Array:
    out = np.zeros((6, 6))
    out[_UPPER] = _floats(text, 21)
    return np.asarray(np.triu(out) + np.triu(out, 1).T)
