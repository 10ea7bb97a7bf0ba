"""Linear least squares on a graph of vectors: one factorisation, several right-hand sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.graph.factor_graph import FactorGraph
from heliograph.graph.factors import LinearMotion, Prior
from heliograph.graph.noise import Information, Isotropic, Noise
from heliograph.graph.problem import Problem
from heliograph.graph.values import Values

__all__ = ["Anchors", "Differences", "connected", "solve_linear"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Rows ``x_j - F x_i - u``, for K columns of unknowns that share F and weight.

    Parameters
    ----------
    i, j : (E,) int64
        Unknowns.
    F : (E, d, d) float64
        Transitions.
    u : (E, d, K) float64
        Offsets.
    weight : (E,) or (E, d, d) float64
        Information, positive or positive semi-definite.
    """

    i: Indices
    j: Indices
    F: Array
    u: Array
    weight: Array


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
    count: int, differences: Differences, anchors: Anchors, held: Anchors, *, threads: int = 1
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
    threads : int
        For the native parts.

    Notes
    -----
    The native problem is a graph of vectors at zero with these factors, so ordering and factorisation are the same code
    as everywhere; its normal equations do not depend on the columns, which enter as right-hand sides.
    """
    d = differences.F.shape[-1]
    x = np.zeros((count, d, differences.u.shape[-1]))
    x[held.at] = held.value
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(count), np.zeros((count, d)))
    graph.add(LinearMotion(differences.i, differences.j, differences.F, np.zeros(d), _noise(differences.weight)))
    if len(anchors.at):
        graph.add(Prior(anchors.at, np.zeros((len(anchors.at), d)), _noise(anchors.weight)))
    graph.fix(held.at)
    columns = _right_hand_sides(x, differences, anchors)
    columns[held.at] = 0.0
    problem = Problem(graph, values, threads=threads)
    if problem.free_scalars == 0:
        return x
    problem.analyze()
    problem.linearize()
    if problem.factorize(0.0, 0.0) is not None:
        return None
    rows = np.ascontiguousarray(np.moveaxis(columns, -1, 0)).reshape(x.shape[-1], -1)
    free = np.moveaxis(problem.native.solve_for(rows).reshape(x.shape[-1], count, d), 0, -1).copy()
    free[held.at] = 0.0
    return np.asarray(x + free) if np.isfinite(free).all() else None


def _noise(weight: Array) -> Noise:
    return Isotropic(1.0 / np.sqrt(weight)) if weight.ndim == 1 else Information(weight)


def _right_hand_sides(x: Array, differences: Differences, anchors: Anchors) -> Array:
    """Return J' W u (count, d, K), with u less what the values x already explain."""
    e = differences
    weighted = _weigh(e.weight, e.u - (x[e.j] - e.F @ x[e.i]))
    columns = np.zeros_like(x)
    np.add.at(columns, e.j, weighted)
    np.subtract.at(columns, e.i, np.swapaxes(e.F, 1, 2) @ weighted)
    if len(anchors.at):
        np.add.at(columns, anchors.at, _weigh(anchors.weight, anchors.value - x[anchors.at]))
    return columns


def _weigh(weight: Array, u: Array) -> Array:
    return np.asarray(weight[:, None, None] * u if weight.ndim == 1 else weight @ u)
