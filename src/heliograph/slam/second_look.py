"""Keyframes at which no loop was found as odometry knew too little: one more look when a loop tells the way."""

from __future__ import annotations

from typing import ClassVar

from heliograph.snapshots import Stateful

__all__ = ["SecondLook"]

_KEPT = 64  # latest keyframes that are remembered: about as far back as one loop tells the way


class SecondLook(Stateful):
    """Keyframes whose candidates were all refused.

    Most are refused because odometry cannot tell a place from its twin. The first loop that is believed can: then those
    before it are looked at again, each once, from where the graph has them now.
    """

    _STATE: ClassVar = {"_refused": [int], "_due": [int], "_again": [int]}

    def __init__(self) -> None:
        self._refused: list[int] = []
        self._due: list[int] = []
        self._again: list[int] = []

    def __len__(self) -> int:
        """Return how many are to be looked at again."""
        return len(self._due)

    def refused(self, query: int) -> None:
        """Take note of a keyframe whose candidates were all refused; it is forgotten if that was its second look."""
        if query not in self._again:
            self._refused = [*self._refused, query][-_KEPT:]

    def accepted(self) -> None:
        """Take note that a loop was accepted elsewhere: those refused so far are to be looked at again."""
        self._due += sorted(self._refused)
        self._again = [*self._again, *sorted(self._refused)][-4 * _KEPT :]
        self._refused = []

    def take(self) -> int:
        """Return the first that is to be looked at again, and count it as looked at."""
        return self._due.pop(0)
