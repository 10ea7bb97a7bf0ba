"""A part of a graph: some of its factors, without checking or whitening them again."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Indices
from heliograph.graph.model.factor_graph import Added, FactorGraph
from heliograph.graph.model.noise import Whitening
from heliograph.graph.model.records import FactorRecord

__all__ = ["split", "subgraph"]


def subgraph(
    graph: FactorGraph, chosen: NDArray[np.bool_], plain: NDArray[np.bool_] | None = None
) -> tuple[FactorGraph, Indices]:
    """Return a graph of some factors with the same held variables, and which factor (M,) each of its own was.

    Parameters
    ----------
    graph : FactorGraph
        Not changed.
    chosen : (N,) bool
        Factors to take.
    plain : (N,) bool, optional
        Factors that lose their robust kernel.
    """
    part, numbers = FactorGraph(), []
    plain = np.zeros(len(graph), dtype=bool) if plain is None else plain
    for added in graph.groups():
        span = slice(added.first, added.first + len(added.record))
        for bare in (False, True):
            rows = np.flatnonzero(chosen[span] & (plain[span] == bare))
            if len(rows):
                part.adopt(_rows(added, rows, bare=bare))
                numbers.append(added.first + rows)
    part.fix(graph.fixed)
    return part, np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.int64)


def split(graph: FactorGraph, part: Indices, count: int) -> Iterator[FactorGraph]:
    """Yield `count` graphs, each of the factors whose `part` (N,) is its number; no variable is held in them."""
    groups = []
    for added in graph.groups():
        mine = part[added.first : added.first + len(added.record)]
        order = np.argsort(mine, kind="stable")
        groups.append((added, order, np.searchsorted(mine[order], np.arange(count + 1)).tolist()))
    for number in range(count):
        one = FactorGraph()
        for added, order, bounds in groups:
            if bounds[number] < bounds[number + 1]:
                one.adopt(_rows(added, order[bounds[number] : bounds[number + 1]], bare=False))
        yield one


def _rows(added: Added, rows: Indices, *, bare: bool) -> Added:
    record, noise = added.record, added.whitening
    if not noise.shared:
        roots = np.ascontiguousarray(noise.sqrt_information[rows])
        noise = Whitening(form=noise.form, shared=False, sqrt_information=roots, constrained=noise.constrained)
    return Added(first=0, record=_record_rows(record, rows, bare=bare), whitening=noise)


def _record_rows(record: FactorRecord, rows: Indices, *, bare: bool) -> FactorRecord:
    part = object.__new__(type(record))
    for kind in type(record).__mro__:
        for name in getattr(kind, "__slots__", ()):
            if hasattr(record, name):
                object.__setattr__(part, name, _rows_of(name, getattr(record, name), rows, bare=bare))
    return part


def _rows_of(name: str, value: Any, rows: Indices, *, bare: bool) -> object:  # noqa: ANN401
    if name in ("keys", "measurement"):
        return np.ascontiguousarray(value[rows])
    if name == "data":
        return tuple(np.ascontiguousarray(item[rows]) for item in value)
    return None if name == "kernel" and bare else value
