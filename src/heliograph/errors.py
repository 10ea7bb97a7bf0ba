"""The error hierarchy. A message states the cause, the numbers and the remedy; only the command line prints it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

__all__ = [
    "CalibrationError",
    "ConfigError",
    "DataError",
    "FormatError",
    "GraphError",
    "HeliographError",
    "MissingDependencyError",
    "OutputError",
    "TopicError",
    "UnderconstrainedError",
    "closest",
]


class HeliographError(Exception):
    """Base of every error that Heliograph raises on purpose."""


class ConfigError(HeliographError):
    """A configuration key or value is wrong."""


class DataError(HeliographError):
    """Well-formed input whose content cannot be used: reversed stamps, NaN, a missing sensor."""


class TopicError(DataError):
    """A topic is missing, or the choice between several is not clear; the message lists the valid ones."""


class GraphError(DataError):
    """A factor graph cannot be used as it is; the message names the factors and the keys."""


class UnderconstrainedError(GraphError):
    """A factor graph leaves something undetermined.

    Parameters
    ----------
    message : str
        What is free, and the remedy.
    diagnosis : object, optional
        The record that says which variables can move, and how.
    """

    def __init__(self, message: str, diagnosis: object = None) -> None:
        super().__init__(message)
        self.diagnosis = diagnosis


class FormatError(HeliographError):
    """A file cannot be read as what it should be.

    Parameters
    ----------
    path : Path
        The file.
    reason : str
        What is wrong with it, and the remedy.
    """

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = Path(path)
        self.reason = reason


class MissingDependencyError(HeliographError):
    """An optional package is needed for this input; the message names the install command."""


class CalibrationError(HeliographError):
    """The relation between two sensors is unknown or contradicts the data."""


class OutputError(HeliographError):
    """A result cannot be written."""


def closest(name: str, valid: Iterable[str]) -> str:
    """Return a ``; did you mean 'x'?`` suffix for the nearest valid name, or an empty string."""
    matches = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""
