"""The law of parts that a run can be taken up with."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from heliograph.errors import HeliographError
from heliograph.snapshots import Part, Snapshot, packed, unpacked
from heliograph.testing.bits import bits

__all__ = ["assert_goes_on"]

P = TypeVar("P", bound=Part)
T = TypeVar("T")


def assert_goes_on(
    make: Callable[[], P], step: Callable[[P, T], object], inputs: Sequence[T], *, at: int, records: Iterable[type] = ()
) -> None:
    """Assert that a part which takes up another's state goes on as that does, bit by bit, and refuses what is none.

    Parameters
    ----------
    make : callable
        Returns a new part, always with the same arguments.
    step : callable
        ``step(part, input)`` gives it an input and returns what came of it.
    inputs : sequence
    at : int
        Inputs before the state is taken.
    records : iterable of type
        Classes of the records in the state.
    """
    first, records = make(), tuple(records)
    for item in inputs[:at]:
        step(first, item)
    stored = _Stored(first.snapshot(), records)
    second = make()
    second.restore(stored.read())
    assert stored.same_as(_Stored(second.snapshot(), records)), "what was taken up is not what was left"
    for number, item in enumerate(inputs[at:], at):
        here, there = bits(step(first, item)), bits(step(second, item))
        assert here == there, f"input {number}: another result than without the interruption"
    ends = [_Stored(part.snapshot(), records) for part in (first, second)]
    assert ends[0].same_as(ends[1]), "the ends differ"
    _assert_refuses(make, stored.read())


def _assert_refuses(make: Callable[[], P], snapshot: Snapshot) -> None:
    for spoilt in ({"nothing of ours": 1}, *({**snapshot, name: b"no such value"} for name in snapshot)):
        try:
            make().restore(spoilt)
        except HeliographError:
            continue
        raise AssertionError(f"a state that is none was taken up: {sorted(spoilt)[:3]} ...")


class _Stored:
    """A state as it lies in a file."""

    def __init__(self, snapshot: Snapshot, records: tuple[type, ...]) -> None:
        tree, arrays = packed(snapshot, records)
        self.tree, self.arrays, self._records = json.dumps(tree), [array.copy() for array in arrays], records

    def read(self) -> Snapshot:
        taken: Snapshot = unpacked(json.loads(self.tree), [array.copy() for array in self.arrays], self._records)
        return taken

    def same_as(self, other: _Stored) -> bool:
        return self.tree == other.tree and bits(tuple(self.arrays)) == bits(tuple(other.arrays))
