"""From keys to numbers, many at a time."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Keys

__all__ = ["KeyIndex", "first_duplicate"]


# Fewer keys than this are added to a dictionary, so that a loop of single insertions does not sort over and over.
_FEW = 64
# Keys this dense in their range are looked up in a table instead of searched.
_SPREAD = 4


def first_duplicate(keys: Keys) -> int | None:
    """Return a key that occurs twice, or None."""
    if len(keys) < 2 or bool((keys[1:] > keys[:-1]).all()):
        return None
    ordered = np.sort(keys)
    twice = ordered[1:] == ordered[:-1]
    return int(ordered[1:][np.argmax(twice)]) if twice.any() else None


class KeyIndex:
    """Maps int64 keys to non-negative int64 codes. Insertions in bulk and one by one are both cheap."""

    __slots__ = ("_codes", "_keys", "_recent", "_table")

    def __init__(self) -> None:
        self._keys: Keys = np.zeros(0, dtype=np.int64)  # sorted
        self._codes: Keys = np.zeros(0, dtype=np.int64)
        self._table: Keys | None = None  # codes from the smallest key on, where the keys are dense
        self._recent: dict[int, int] = {}

    def copy(self) -> KeyIndex:
        """Return an independent index; the arrays are never changed in place, so they are shared."""
        other = KeyIndex()
        other._keys, other._codes, other._table = self._keys, self._codes, self._table
        other._recent = dict(self._recent)
        return other

    def add(self, keys: Keys | list[int], start: int) -> int | None:
        """Give keys the codes ``start, start + 1, ...``; return a key taken or twice, and then change nothing."""
        if isinstance(keys, list):
            return self._add_few(keys, start)
        if len(keys) < _FEW:
            return self._add_few(keys.tolist(), start)
        twice = first_duplicate(keys)
        if twice is not None:
            return twice
        taken = self.find(keys) >= 0
        if taken.any():
            return int(keys[np.argmax(taken)])
        self._merge(keys, start + np.arange(len(keys), dtype=np.int64))
        return None

    def add_one(self, key: int, code: int) -> bool:
        """Give one key its code; return False where it is taken, and then change nothing."""
        if key in self._recent or (len(self._keys) and self._find_sorted(key) >= 0):
            return False
        self._recent[key] = code
        return True

    def _add_few(self, keys: list[int], start: int) -> int | None:
        fresh: dict[int, int] = {}
        for offset, key in enumerate(keys):
            if key in fresh or key in self._recent or self._find_sorted(key) >= 0:
                return key
            fresh[key] = start + offset
        self._recent.update(fresh)
        return None

    def _find_sorted(self, key: int) -> int:
        size = len(self._keys)
        if size == 0:
            return -1
        place = int(np.searchsorted(self._keys, key))
        return int(self._codes[place]) if place < size and self._keys[place] == key else -1

    def find(self, keys: Keys) -> Keys:
        """Return the codes (N,) of keys (N,); -1 where a key is unknown."""
        if len(keys) < _FEW and self._recent:
            known = self._recent
            few = [known[key] if key in known else self._find_sorted(key) for key in keys.tolist()]
            return np.array(few, dtype=np.int64)
        if self._recent:
            fresh = np.fromiter(self._recent, dtype=np.int64, count=len(self._recent))
            codes = np.fromiter(self._recent.values(), dtype=np.int64, count=len(self._recent))
            self._recent = {}
            self._merge(fresh, codes)
        if len(self._keys) == 0:
            return np.full(len(keys), -1, dtype=np.int64)
        if self._table is not None:
            # The offset may wrap around for keys at the far ends of int64; as unsigned it is then too large.
            offset = (keys - self._keys[0]).view(np.uint64)
            inside = offset < np.uint64(len(self._table))
            return np.where(inside, self._table[np.where(inside, offset, np.uint64(0)).view(np.int64)], -1)
        place = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return np.where(self._keys[place] == keys, self._codes[place], -1)

    def _merge(self, keys: Keys, codes: Keys) -> None:
        merged, merged_codes = np.concatenate([self._keys, keys]), np.concatenate([self._codes, codes])
        if not bool((merged[1:] > merged[:-1]).all()):
            order = np.argsort(merged, kind="stable")
            merged, merged_codes = merged[order], merged_codes[order]
        self._keys, self._codes, self._table = merged, merged_codes, None
        span = int(merged[-1]) - int(merged[0]) + 1 if len(merged) else 0
        if 0 < span <= _SPREAD * len(merged) + 1024:
            self._table = np.full(span, -1, dtype=np.int64)
            self._table[merged - merged[0]] = merged_codes
