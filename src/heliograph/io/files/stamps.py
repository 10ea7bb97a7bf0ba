"""Stamps in files without a declared unit: file names, lists of times, the first column of a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.guard.limits import MAX_NS
from heliograph.io.files.tum import parse_seconds, whole_ns

__all__ = ["STAMP_FILES", "UNITS", "is_number", "parse_stamps", "stamp_unit"]

STAMP_FILES = ("times.txt", "timestamps.txt", "timestamps.csv", "times.csv", "stamps.txt")
"""Names of files that hold one stamp a row, for the clouds or poses that lie beside them."""

UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit -> the power of ten that makes nanoseconds of it."""

_EPOCH = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": 1e8}  # 1973 in each unit: larger values are times since 1970
_MAX_DIGITS = 25
_STEP_S = (2e-4, 0.5)  # samples between 2 Hz and 5 kHz


def stamp_unit(words: Sequence[str]) -> str:
    """Return the unit in which stamps are written: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.

    Values that can be times since 1970 tell the unit by their size; smaller ones by their median step, which must make
    a rate between 2 Hz and 5 kHz: the largest such unit, or seconds where none does.

    Raises
    ------
    ValueError
        A word is no number.
    """
    values = np.array([float(word) for word in words])
    size = float(np.median(np.abs(values))) if len(values) else 0.0
    for unit, epoch in _EPOCH.items():
        if size >= epoch:
            return unit
    steps = np.diff(values)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    plausible = (unit for unit, power in UNITS.items() if _STEP_S[0] <= step * 10.0 ** (power - 9) <= _STEP_S[1])
    return next(plausible, "s")


def is_number(word: str) -> bool:
    """Tell whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def parse_stamps(words: Sequence[str], unit: str | None = None) -> tuple[NDArray[np.int64], str]:
    """Convert written stamps to nanoseconds, exactly.

    Parameters
    ----------
    words : sequence of str
        Decimal numbers.
    unit : str or None
        Their unit; None infers it, see `stamp_unit`.

    Returns
    -------
    stamps_ns : (N,) int64
        [ns].
    unit : str
        The unit.

    Raises
    ------
    ValueError
        A word is no finite number.
    """
    unit = stamp_unit(words) if unit is None else unit
    if unit == "s":
        return np.array([_bounded(parse_seconds(word), word) for word in words], dtype=np.int64), unit
    scale = 10 ** UNITS[unit]
    stamps = [_scaled(word, scale) for word in words]
    return np.array(stamps, dtype=np.int64), unit


def _scaled(word: str, scale: int) -> int:
    """Convert a number; signs, fractions and exponents are rare in units below the second."""
    try:
        ns = int(word) * scale if word.isdecimal() and len(word) <= _MAX_DIGITS else whole_ns(word, scale)
    except (ArithmeticError, ValueError) as error:
        raise ValueError(f"not a stamp: {word[:60]!r}") from error
    return _bounded(ns, word)


def _bounded(ns: int, word: str) -> int:
    if not -MAX_NS <= ns <= MAX_NS:
        raise ValueError(f"a stamp that is no time: {word[:60]!r}")
    return ns
