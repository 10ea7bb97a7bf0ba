"""The factor graph: records of factors in the order of addition, and the variables that are held."""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.errors import GraphError
from heliograph.graph.model.noise import Whitening
from heliograph.graph.model.records import FactorRecord, as_keys, key_list
from heliograph.graph.model.values import Values

__all__ = ["Added", "FactorGraph"]

_SHOWN = 20  # records that are printed


class Added(NamedTuple):
    """A record as it stands in a graph.

    Parameters
    ----------
    first : int
        Number of its first factor in the graph.
    record : FactorRecord
        What was added.
    whitening : Whitening
        Its noise, checked, in the simplest form.
    """

    first: int
    record: FactorRecord
    whitening: Whitening

    def name(self, row: int) -> str:
        """Return ``factor 17 (keys 3, 4)`` for a row of the record."""
        return f"factor {self.first + row} ({key_list(self.record.keys[row])})"


class FactorGraph:
    """Factors between variables. Factors have numbers in the order of addition.

    Examples
    --------
    >>> graph = FactorGraph()
    >>> graph.add(Prior(0, SE2.identity(), Isotropic(0.01)))
    range(0, 1)
    >>> graph.add(Between(np.arange(99), np.arange(1, 100), odometry, Diagonal([0.01, 0.1, 0.1])))
    range(1, 100)
    """

    __slots__ = ("_added", "_count", "_firsts", "_fixed")

    def __init__(self) -> None:
        self._added: list[Added] = []
        self._firsts: list[int] = []
        self._fixed: list[NDArray[np.int64]] = []
        self._count = 0

    def add(self, record: FactorRecord) -> range:
        """Add the factors of a record and return their numbers.

        Parameters
        ----------
        record : FactorRecord
            Such as `Between`, for one factor or many.

        Raises
        ------
        GraphError
            A factor joins a variable with itself, a measurement is not finite or not on its manifold, or the noise is
            not positive (semi-definite); the message names the factor and its keys. Nothing is added then.
        """
        if not isinstance(record, FactorRecord):
            raise GraphError(f"a {type(record).__name__} is no factor; add Prior, Between, ... or a Factor of your own")
        first = self._count
        ready = record.noise.ready(record.rows) if record.sound else None
        self._added.append(Added(first, record, _whitening(record, first) if ready is None else ready))
        self._firsts.append(first)
        self._count = first + len(record)
        return range(first, self._count)

    def adopt(self, added: Added) -> range:
        """Add what a graph has checked already, and return the numbers of the factors here."""
        first = self._count
        self._added.append(Added(first=first, record=added.record, whitening=added.whitening))
        self._firsts.append(first)
        self._count += len(added.record)
        return range(first, self._count)

    def fix(self, keys: ArrayLike) -> None:
        """Hold variables at their values: they are not estimated.

        Parameters
        ----------
        keys : int or (N,) int
            Fixing one twice does nothing more.
        """
        self._fixed.append(as_keys(keys).reshape(-1).copy())

    @property
    def fixed(self) -> NDArray[np.int64]:
        """Keys that are held, sorted, (M,)."""
        return np.unique(np.concatenate(self._fixed)) if self._fixed else np.zeros(0, dtype=np.int64)

    def groups(self) -> tuple[Added, ...]:
        """Return what was added, in order."""
        return tuple(self._added)

    def factor(self, number: int) -> tuple[FactorRecord, int]:
        """Return the record that holds the factor of a number, and its row there.

        Raises
        ------
        GraphError
            There is no such factor.
        """
        added, row = self._place(number)
        return added.record, row

    def name(self, number: int) -> str:
        """Return ``factor 17 (keys 3, 4)`` for messages."""
        added, row = self._place(number)
        return added.name(row)

    def _place(self, number: int) -> tuple[Added, int]:
        if not 0 <= number < self._count:
            raise GraphError(f"there is no factor {number}; the graph has {self._count}")
        added = self._added[bisect.bisect_right(self._firsts, number) - 1]
        return added, number - added.first

    def errors(self, values: Values) -> NDArray[np.float64]:
        """Return what each factor costs at some values, (N,): ``|r|^2 / 2`` of its whitened residual, or rho(|r|).

        Parameters
        ----------
        values : Values
            One for every variable.

        Raises
        ------
        GraphError
            The graph does not fit the values.
        """
        # A graph is data; what it costs takes the native side, which stands a storey higher.
        costs: NDArray[np.float64] = import_module("heliograph.graph.problem.problem").factor_costs(self, values)
        return costs

    def error(self, values: Values) -> float:
        """Return the sum of `errors`: half of what `Solution.cost` says, as gtsam counts it."""
        return float(self.errors(values).sum())

    def copy(self) -> FactorGraph:
        """Return a graph with the same factors that can be added to by itself; the records are shared."""
        other = FactorGraph()
        other._added, other._firsts, other._fixed = list(self._added), list(self._firsts), list(self._fixed)
        other._count = self._count
        return other

    def __len__(self) -> int:
        """Return the number of factors."""
        return self._count

    def __iter__(self) -> Iterator[FactorRecord]:
        """Iterate over the records in order."""
        return (added.record for added in self._added)

    def __repr__(self) -> str:
        kinds = Counter[str]()
        for added in self._added:
            kinds[added.record.kind] += len(added.record)
        parts = [f"{count} {kind}" for kind, count in kinds.items()]
        held = len(self.fixed)
        return f"FactorGraph({', '.join([*parts, *([f'{held} held'] if held else [])])})"

    def __str__(self) -> str:
        """Return every record a line with its factors' numbers and keys, cut off after some."""
        lines = [repr(self)]
        for added in self._added[:_SHOWN]:
            last = added.first + len(added.record) - 1
            numbers = f"factor {last}" if last == added.first else f"factors {added.first}-{last}"
            if len(added.record):
                lines.append(f"  {numbers}: {added.record!r}")
        if len(self._added) > _SHOWN:
            lines.append(f"  ... ({len(self._added)} records in all)")
        if len(self.fixed):
            lines.append(f"  held: {key_list(self.fixed)}")
        return "\n".join(lines)


def _whitening(record: FactorRecord, first: int) -> Whitening:
    """Return the noise of a record, ready; or say which factor is wrong."""
    keys = record.keys

    def name(row: int) -> str:
        return f"factor {first + row} ({key_list(keys[row])})" if len(keys) else f"factor {first}"

    itself = _twice(keys)
    if itself is not None and itself.any():
        raise GraphError(f"{name(int(np.argmax(itself)))}: {record.kind} joins a variable with itself")
    flaws = record.flaws()
    if flaws.any():
        row = int(np.argmax(flaws))
        raise GraphError(f"{name(row)}: {_flaw(record, row)}")
    ready = record.noise.ready(record.rows) if len(keys) == 1 else None
    return record.noise.whitening(record.rows, len(record), name) if ready is None else ready


def _twice(keys: NDArray[np.int64]) -> NDArray[np.bool_] | None:
    """Return which factors (N,) join a variable with itself; None if they join only one."""
    if keys.shape[1] == 1:
        return None
    if keys.shape[1] == 2:
        return np.asarray(keys[:, 0] == keys[:, 1])
    ordered = np.sort(keys, axis=1)
    return np.asarray((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))


def _flaw(record: FactorRecord, row: int) -> str:
    numbers = record.measurement[row]
    if numbers.size == 0:
        return f"data of {record.kind} are not finite"
    shown = np.array2string(numbers, precision=6, separator=", ", threshold=30).replace("\n", "")
    fault = "is impossible" if np.isfinite(numbers).all() else "is not finite"
    return f"the measurement of {record.kind} {fault}: {shown}"
