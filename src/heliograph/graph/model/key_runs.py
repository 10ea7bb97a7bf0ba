"""A set of keys that takes memory by runs of neighbouring keys, not by keys."""

from __future__ import annotations

from bisect import bisect_right

__all__ = ["KeyRuns"]


class KeyRuns:
    """Keys kept as runs ``first .. last``: numbers that are handed out one after another stay a single run."""

    __slots__ = ("_first", "_last")

    def __init__(self) -> None:
        self._first: list[int] = []  # ascending
        self._last: list[int] = []

    def add(self, key: int) -> None:
        """Add a key; one that is there already changes nothing."""
        at = bisect_right(self._first, key)  # the run before the key is at - 1
        if at and key <= self._last[at - 1]:
            return
        extends = at > 0 and self._last[at - 1] == key - 1
        meets = at < len(self._first) and self._first[at] == key + 1
        if extends and meets:
            self._last[at - 1] = self._last.pop(at)
            del self._first[at]
        elif extends:
            self._last[at - 1] = key
        elif meets:
            self._first[at] = key
        else:
            self._first.insert(at, key)
            self._last.insert(at, key)

    def __contains__(self, key: int) -> bool:
        at = bisect_right(self._first, key)
        return at > 0 and key <= self._last[at - 1]

    def runs(self) -> list[tuple[int, int]]:
        """Return first and last key of each run, ascending."""
        return list(zip(self._first, self._last, strict=True))

    @classmethod
    def of(cls, runs: list[tuple[int, int]]) -> KeyRuns:
        """Return the set that `runs` describes."""
        keys = cls()
        keys._first, keys._last = [first for first, _ in runs], [last for _, last in runs]
        return keys
