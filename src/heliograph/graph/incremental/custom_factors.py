"""The user's own factors in an incremental smoother: their variables and data, and what they evaluate to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.families import Family

__all__ = ["CustomFactors", "CustomKind", "Evaluated"]

Int32s = NDArray[np.int32]
Point: TypeAlias = Callable[[Int32s], Array]  # packed values of variables, one after another
Evaluated: TypeAlias = tuple[Int32s, Array, list[Array]]  # numbers, residuals and Jacobians, each flat


@dataclass(slots=True)
class CustomKind:
    """Factors of one class between variables of the same families, by factor number."""

    factor: type[Factor]
    families: tuple[Family, ...]
    scopes: dict[int, Int32s] = field(default_factory=dict)
    data: dict[int, tuple[Array, ...]] = field(default_factory=dict)

    def evaluate(self, numbers: Int32s, point: Point) -> Evaluated:
        """Return residuals (N, rows) and Jacobians (N, rows, dof) of factors, flat, at values that `point` gives."""
        scopes = np.stack([self.scopes[n] for n in numbers.tolist()])
        arrays = [
            family.elements(point(np.ascontiguousarray(column)).reshape(-1, family.storage))
            for family, column in zip(self.families, scopes.T, strict=True)
        ]
        data = tuple(np.stack(items) for items in zip(*(self.data[n] for n in numbers.tolist()), strict=True))
        residual, jacobians = self.factor.evaluate(arrays, data, families=self.families)
        flat = [np.ascontiguousarray(J).reshape(-1) for J in jacobians]
        return numbers, np.ascontiguousarray(residual).reshape(-1), flat


class CustomFactors:
    """The user's own factors, by kind as the native tree numbers kinds."""

    def __init__(self) -> None:
        self.kinds: dict[int, CustomKind] = {}

    def __iter__(self) -> Iterator[tuple[int, CustomKind]]:
        return iter(self.kinds.items())

    def enter(self, kind: int, numbers: Int32s, scopes: Int32s, data: tuple[Array, ...]) -> list[int]:
        """Note new factors; return their numbers, none where the kind is a built-in one."""
        own = self.kinds.get(kind)
        if own is None:
            return []
        entered: list[int] = numbers.tolist()
        for row, number in enumerate(entered):
            own.scopes[number] = scopes[row]
            own.data[number] = tuple(item[row] for item in data)
        return entered

    def drop(self, numbers: list[int]) -> None:
        """Forget factors; numbers of built-in ones are passed over."""
        if numbers:
            for own in self.kinds.values():
                for number in numbers:
                    own.scopes.pop(number, None)
                    own.data.pop(number, None)

    def classes(self) -> tuple[type[Factor], ...]:
        """Return their classes, each once."""
        return tuple(dict.fromkeys(own.factor for own in self.kinds.values()))
