"""Linear least squares on a graph of vectors: one factorisation, several right-hand sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph import _core
from heliograph._core import GraphProblem
from heliograph.arrays import Array, Indices, freeze
from heliograph.graph.model.noise import FULL, SCALAR, Information
from heliograph.graph.problem.settings import ORDERINGS

__all__ = ["Anchors", "Differences", "connected", "solve_linear"]


_PRIOR, _LINEAR_MOTION = 1, 7  # codes of factors


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Rows ``x_j - F x_i - u``, for K columns of unknowns that share F and weight.

    Parameters
    ----------
    i, j : (E,) int64
        Unknowns.
    F : (E, d, d) float64
        Transitions.
    u : (E, d, K) float64 or None
        Offsets; None: all zero.
    columns : int
        K.
    weight : (E,) or (E, d, d) float64
        Information, positive or positive semi-definite.
    """

    i: Indices
    j: Indices
    F: Array
    u: Array | None
    columns: int
    weight: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Anchors:
    """Rows ``x - value``; for unknowns that are held, ``weight`` is not used.

    Parameters
    ----------
    at : (A,) int64
        Unknowns.
    value : (A, d, K) float64
        Where they should be.
    weight : (A,) or (A, d, d) float64
        Information.
    """

    at: Indices
    value: Array
    weight: Array

    def __post_init__(self) -> None:
        freeze(self)


def connected(count: int, i: Indices, j: Indices) -> Indices:
    """Return the component of each of `count` nodes, (count,): the smallest node in it."""
    label = np.arange(count)
    while True:
        low = np.minimum(label[i], label[j])
        before = label.copy()
        # The root of the larger label is hooked to the smaller one; then every node looks its root's label up.
        np.minimum.at(label, before[i], low)
        np.minimum.at(label, before[j], low)
        while not np.array_equal(label, label[label]):
            label = label[label]
        if np.array_equal(label, before):
            return label


def solve_linear(
    count: int,
    differences: Differences,
    anchors: Anchors,
    held: Anchors,
    *,
    order: Indices | None = None,
    threads: int = 1,
) -> Array | None:
    """Return the x (count, d, K) that minimise the sum of weighted squares, or None if they are not determined.

    Parameters
    ----------
    count : int
        Number of unknowns; each is in some row.
    differences, anchors : Differences, Anchors
        The rows.
    held : Anchors
        Unknowns with known values, one entry each.
    order : (M,) int64, optional
        In which the unknowns are eliminated; one is found without it.
    threads : int
        For the native parts.

    Notes
    -----
    The native problem is a graph of vectors at zero with linear-motion factors and priors, so ordering and
    factorisation are the same code as everywhere; its normal equations do not depend on the columns, which enter as
    right-hand sides.
    """
    d = differences.F.shape[-1]
    x = np.zeros((count, d, differences.columns))
    x[held.at] = held.value
    if len(held.at) == count:
        return x
    native = _core.GraphProblem(np.zeros(1, np.int32), np.array([d], np.int32), np.array([count], np.int64))
    flat = differences.F.reshape(len(differences.i), d * d)
    _add(native, _LINEAR_MOTION, (differences.i, differences.j), flat, differences.weight, d)
    if len(anchors.at):
        _add(native, _PRIOR, (anchors.at,), np.zeros((len(anchors.at), 0)), anchors.weight, d)
    native.hold(held.at.astype(np.int32))
    native.set_values(np.zeros(count * d))
    if order is None:
        native.analyze(ORDERINGS["auto"])
    else:
        native.analyze_in(order.astype(np.int32))
    native.linearize(threads)
    if native.factorize(0.0, 0.0, threads) >= 0:
        return None
    columns = _right_hand_sides(x, differences, anchors, held)
    free = native.solve_for(np.ascontiguousarray(columns.reshape(count * d, -1).T)).T.reshape(x.shape)
    x = x + free
    x[held.at] = held.value
    return x if np.isfinite(x).all() else None


def _add(native: GraphProblem, code: int, ends: tuple[Indices, ...], measured: Array, weight: Array, d: int) -> None:
    """Add factors without an offset: it enters with the right-hand sides."""
    variables = np.stack(ends, axis=1).astype(np.int32)
    measurement = np.concatenate([measured, np.zeros((len(variables), d))], axis=1)
    if weight.ndim == 1:
        form, root = SCALAR, np.sqrt(weight)
    else:
        form, root = FULL, Information(weight).sqrt_information(d, len(weight)).reshape(-1)
    native.add_group(code, variables, d, np.ascontiguousarray(measurement), form, False, root, 0, 1.0)


def _right_hand_sides(x: Array, differences: Differences, anchors: Anchors, held: Anchors) -> Array:
    """Return J' W u (count, d, K), with u less what the held unknowns already explain; zero where they are."""
    e = differences
    known = np.zeros(len(x), dtype=bool)
    known[held.at] = True
    # Without offsets only the rows beside held unknowns have a right-hand side.
    rows = np.flatnonzero(known[e.i] | known[e.j]) if e.u is None else np.arange(len(e.i))
    i, j, F = e.i[rows], e.j[rows], e.F[rows]
    offset = F @ x[i] - x[j]
    weighted = _weigh(e.weight[rows], offset if e.u is None else e.u + offset)
    columns = _sum_at(j, weighted, len(x)) - _sum_at(i, np.swapaxes(F, 1, 2) @ weighted, len(x))
    if len(anchors.at):
        columns += _sum_at(anchors.at, _weigh(anchors.weight, anchors.value - x[anchors.at]), len(x))
    columns[known] = 0.0
    return columns


def _sum_at(at: Indices, rows: Array, count: int) -> Array:
    """Return the sums (count, ...) of the rows of each index; one pass a column is many times faster than `add.at`."""
    flat = rows.reshape(len(at), int(np.prod(rows.shape[1:])))  # -1 has no meaning where there are no rows
    sums = np.stack([np.bincount(at, column, count) for column in flat.T], axis=1)
    return np.asarray(sums, dtype=np.float64).reshape(count, *rows.shape[1:])


def _weigh(weight: Array, u: Array) -> Array:
    return np.asarray(weight[:, None, None] * u if weight.ndim == 1 else weight @ u)
