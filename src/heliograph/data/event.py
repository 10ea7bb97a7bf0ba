"""Something that a user should know about a run."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Event"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A warning or a remark with its cause, numbers and remedy.

    Parameters
    ----------
    code : str
        Short stable name, e.g. ``"imu-gap"``; tests and tools match on it.
    message : str
        One line: cause, numbers, remedy.
    stamp_ns : int or None
        When it happened in the recording [ns].
    severity : str
        ``"info"``, ``"warning"`` or ``"error"``.
    count : int
        How often it happened, when repeats were folded into one.
    """

    code: str
    message: str
    stamp_ns: int | None = None
    severity: str = "warning"
    count: int = 1
