"""Values of the variables, stacked by family."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.model.families import Family, Value, family_named, lone_value, stacked
from heliograph.graph.model.key_index import KeyIndex
from heliograph.graph.model.records import as_keys, key_list, plain_key
from heliograph.graph.model.symbols import key_name
from heliograph.lie import S2, ExtendedPose

__all__ = ["Values"]


# A code is the number of the family and, below these bits, the place within it.
_SHIFT = 40
_SHOWN = 10  # values of a family that are printed


class _Block:
    """The keys and packed values of one family, in the order of insertion, with room to grow."""

    __slots__ = ("_keys", "_packed", "count", "family")

    def __init__(self, family: Family) -> None:
        self.family = family
        self.count = 0
        self._keys = np.empty(0, dtype=np.int64)
        self._packed = np.empty((0, family.storage))

    @property
    def keys(self) -> Keys:
        return self._keys[: self.count]

    @property
    def packed(self) -> Array:
        return self._packed[: self.count]

    def append(self, keys: Keys, packed: Array) -> None:
        total = self.count + len(keys)
        if total > len(self._keys):
            self._grow(total)
        self._keys[self.count : total], self._packed[self.count : total] = keys, packed
        self.count = total

    def row(self) -> Array:
        """Room (1, storage) for one more value; it counts from `fill_row` on."""
        if self.count == len(self._keys):
            self._grow(self.count + 1)
        return self._packed[self.count : self.count + 1]

    def fill_row(self, key: int) -> None:
        self._keys[self.count] = key
        self.count += 1

    def _grow(self, total: int) -> None:
        room = max(total, 2 * self.count)
        grown_keys, grown = np.empty(room, dtype=np.int64), np.empty((room, self.family.storage))
        grown_keys[: self.count], grown[: self.count] = self.keys, self.packed
        self._keys, self._packed = grown_keys, grown

    def with_packed(self, packed: Array) -> _Block:
        other = _Block(self.family)
        other._keys, other._packed, other.count = self.keys.copy(), packed, self.count
        return other


class Values:
    """Values of variables by key. A key is an integer, unique over all families.

    Examples
    --------
    >>> values = Values()
    >>> values.insert([0, 1], SE2.exp([[0.0, 0.0, 0.0], [0.1, 1.0, 0.0]]))
    >>> values.insert(100, [3.0, 4.0])
    >>> values.at(1)  # an SE2
    """

    __slots__ = ("_blocks", "_index", "_numbers")

    def __init__(self) -> None:
        self._blocks: list[_Block] = []
        self._numbers: dict[Family, int] = {}
        self._index = KeyIndex()

    def insert(self, keys: ArrayLike, value: Value) -> None:
        """Add variables.

        Parameters
        ----------
        keys : int or (N,) int
            None of them used before.
        value : lie value or (d,) or (N, d) float64
            One for an int, a batch of N for (N,) keys.

        Raises
        ------
        GraphError
            A key is there already or twice in the call, the numbers differ, or a value is not finite or no rotation.
        """
        if type(keys) is int and plain_key(keys) and self._insert_one(keys, value):
            return
        array, elements, family = self._checked(keys, value)
        packed = family.pack_elements(elements)
        number = self._numbers.get(family)
        block = _Block(family) if number is None else self._blocks[number]
        if number is None:
            number = len(self._blocks)
        start = (number << _SHIFT) + block.count
        taken = self._index.add(array, start)
        if taken is not None:
            raise _used_twice(taken)
        if number == len(self._blocks):
            self._blocks.append(block)
            self._numbers[family] = number
        block.append(array, packed)

    def _insert_one(self, key: int, value: Value) -> bool:
        """Add one variable if its value needs no closer look; return whether it was."""
        lone = lone_value(value)
        if lone is None:
            return False
        elements, family = lone
        number = self._numbers.get(family)
        block = _Block(family) if number is None else self._blocks[number]
        if not _core.pack_single(family.code, elements, block.row()):
            return False
        if not self._index.add_one(key, ((len(self._blocks) if number is None else number) << _SHIFT) + block.count):
            raise _used_twice(key)
        if number is None:
            self._numbers[family] = len(self._blocks)
            self._blocks.append(block)
        block.fill_row(key)
        return True

    def update(self, keys: ArrayLike, value: Value) -> None:
        """Replace the values of variables that are there; parameters and errors as in `insert`."""
        array, elements, family = self._checked(keys, value)
        number, places = self._located(array)
        block = self._blocks[number] if len(array) else None
        if block is None:
            return
        if block.family != family:
            raise GraphError(f"{key_list(array)}: the variables are {block.family.name}, the new values {family.name}")
        block.packed[places] = family.pack_elements(elements)

    def at(self, keys: ArrayLike) -> Value:
        """Return the values of keys: a lie value, or an array for vectors; one key gives one element.

        Parameters
        ----------
        keys : int or (N,) int
            All of one family.

        Raises
        ------
        GraphError
            A key is missing, or the families differ.
        """
        array = as_keys(keys)
        if array.size == 0:
            raise GraphError("no keys, so there is no family to return values of; use `block`")
        number, places = self._located(array.reshape(-1))
        family = self._blocks[number].family
        elements = family.elements(self._blocks[number].packed[places])
        return family.wrap(elements[0] if array.ndim == 0 else elements)

    def block(self, family: object) -> tuple[Keys, Any]:
        """Return all keys (N,) and the stacked values of a family, in the order of insertion.

        Parameters
        ----------
        family : type, int or Family
            A lie class such as ``SE3``, or the dimension of vectors.
        """
        wanted = family_named(family)
        number = self._numbers.get(wanted)
        block = _Block(wanted) if number is None else self._blocks[number]
        return block.keys.copy(), wanted.unpack(block.packed.copy())

    def families(self) -> tuple[Family, ...]:
        """Return the families in the order in which they were first inserted."""
        return tuple(block.family for block in self._blocks)

    def keys(self) -> Keys:
        """Return all keys (N,), family by family, each in the order of insertion: the dense order."""
        if len(self._blocks) == 1:
            return np.array(self._blocks[0].keys)
        return np.concatenate([block.keys for block in self._blocks]) if self._blocks else np.zeros(0, dtype=np.int64)

    def keys_by_family(self) -> list[list[int]]:
        """Return the keys of each family, each in the order of insertion."""
        return [block.keys.tolist() for block in self._blocks]

    def counts(self) -> tuple[int, ...]:
        """Return the number of variables of each family."""
        return tuple(block.count for block in self._blocks)

    def packed(self) -> tuple[Array, ...]:
        """Return the packed values (N, storage) of each family; views that must not be written."""
        return tuple(block.packed for block in self._blocks)

    def with_packed(self, packed: Sequence[Array]) -> Values:
        """Return values with the same keys and other numbers, one array (N, storage) a family."""
        other = Values()
        for block, numbers in zip(self._blocks, packed, strict=True):
            array = np.array(numbers, dtype=np.float64, order="C").reshape(block.count, block.family.storage)
            other._blocks.append(block.with_packed(array))
        other._numbers, other._index = dict(self._numbers), self._index.copy()
        return other

    def copy(self) -> Values:
        """Return independent values with the same content."""
        return self.with_packed(self.packed())

    def dense(self, keys: ArrayLike) -> NDArray[np.int64]:
        """Return the dense indices of keys, of the same shape; -1 where a key has no value.

        A dense index counts the variables family by family, each family in the order of insertion.
        """
        array = as_keys(keys)
        codes = self._index.find(array.reshape(-1))
        first = np.concatenate([[0], np.cumsum(self.counts())]).astype(np.int64)
        found = codes >= 0
        where = np.where(found, codes, 0)
        dense = first[where >> _SHIFT] + (where & ((1 << _SHIFT) - 1))
        return np.where(found, dense, -1).reshape(array.shape)

    def __contains__(self, key: object) -> bool:
        if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
            return bool(self._index.find(as_keys(key).reshape(1))[0] >= 0)
        return False

    def __len__(self) -> int:
        return sum(block.count for block in self._blocks)

    def __repr__(self) -> str:
        parts = ", ".join(f"{block.count} {block.family.name}" for block in self._blocks)
        return f"Values({parts})"

    def __str__(self) -> str:
        """Return every variable a line, cut off after some."""
        lines = [repr(self)]
        for block in self._blocks:
            shown = min(block.count, _SHOWN)
            values = block.family.elements(block.packed[:shown])
            for key, value in zip(block.keys[:shown].tolist(), values, strict=True):
                lines.append(f"  {key_name(key)}: {_described(block.family, value)}")
            if block.count > shown:
                lines.append(f"  ... ({block.count} {block.family.name} in all)")
        return "\n".join(lines)

    def _checked(self, keys: ArrayLike, value: Value) -> tuple[Keys, Array, Family]:
        array = as_keys(keys)
        elements, family, single = stacked(value)
        if array.ndim > 1 or (array.ndim == 0) != single or (not single and len(array) != len(elements)):
            given = "1 value" if single else f"{len(elements)} values"
            raise GraphError(
                f"keys of shape {array.shape} and {given} of {family.name}; an int takes one value and (N,) keys take N"
            )
        array = array.reshape(-1)
        bad = family.off_manifold(elements)
        if bad.any():
            index = int(np.argmax(bad))
            numbers = np.array2string(elements[index], precision=6, separator=", ", threshold=30).replace("\n", "")
            fault = "no value of" if np.isfinite(elements[index]).all() else "not finite, so no value of"
            raise GraphError(f"key {key_name(int(array[index]))}: {numbers} is {fault} {family.name}")
        return array, elements, family

    def _located(self, keys: Keys) -> tuple[int, NDArray[np.int64]]:
        """Return the number of the family and the places within it."""
        codes = self._index.find(keys)
        if (codes < 0).any():
            raise GraphError(f"no value for {key_list(keys[codes < 0])}")
        numbers = codes >> _SHIFT
        if len(codes) and (numbers != numbers[0]).any():
            names = sorted({self._blocks[n].family.name for n in np.unique(numbers).tolist()})
            raise GraphError(f"{key_list(keys)} are of several families ({', '.join(names)}); ask for one at a time")
        return (int(numbers[0]) if len(codes) else 0), codes & ((1 << _SHIFT) - 1)


def _used_twice(key: int) -> GraphError:
    return GraphError(
        f"key {key_name(key)} is used twice; keys are unique over all families, and `update` changes values"
    )


def _described(family: Family, value: Array) -> str:
    """Return a value in a line: its tangent vector from the identity, and its position where it has one."""
    if family.lie is None or family.lie is S2:
        return np.array2string(value, precision=6, suppress_small=True, separator=", ")
    flat = np.asarray(family.lie(value).log())
    turn = flat[: 1 if family.space == 2 or family.dof == 1 else 3]
    parts = [f"rotation {np.array2string(turn, precision=6, suppress_small=True, separator=', ')}"]
    if family.space:
        at = value[: family.space, family.space]
        parts.append(f"position {np.array2string(at, precision=6, suppress_small=True, separator=', ')}")
    if family.lie is ExtendedPose:
        parts.append(f"velocity {np.array2string(value[:3, 4], precision=6, suppress_small=True, separator=', ')}")
    return ", ".join(parts)
