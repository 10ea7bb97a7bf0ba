"""What was concluded about a recording, and why."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Inference", "make_inference"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Inference:
    """One conclusion about a recording.

    Parameters
    ----------
    name : str
        What it is about, e.g. ``"point time unit"``.
    value : str
        The conclusion.
    evidence : str
        The numbers that led to it.
    source : str
        ``"data"``, ``"override"`` (the user said so) or ``"default"`` (the data do not tell).
    """

    name: str
    value: str
    evidence: str
    source: str = "data"


def make_inference(name: str, value: str, evidence: str, *, source: str = "data") -> Inference:
    """Return an `Inference`; shorter where many are made."""
    return Inference(name=name, value=value, evidence=evidence, source=source)
