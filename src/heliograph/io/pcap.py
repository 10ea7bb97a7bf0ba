"""Placeholder until the reader of the 'files' part is merged: it knows no input."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from heliograph.io.raw import RawSource

__all__ = ["open_pcap"]


def open_pcap(paths: Sequence[Path]) -> RawSource | None:  # noqa: ARG001
    """Return None: no input is of this kind."""
    return None
