"""Which doubtful relative poses are borne out by others: pairs that agree around a short trusted loop.

Two measurements between the same two stretches of a trusted trajectory must tell the same story, however far the
trajectory has drifted between the stretches; random mistakes hardly ever do.

References
----------
.. [1] J. G. Mangelson et al., "Pairwise consistent measurement set maximization for robust multi-robot map merging",
   ICRA 2018 (the test of a pair; here it only counts neighbours, so it stays linear in their number).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from heliograph.arrays import Array, Indices, freeze

__all__ = ["Stretch", "agreeing"]


_PAIRS = 1_000_000  # tested at a time, to bound memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Relative poses between variables 0 ... n-1 of one family.

    Parameters
    ----------
    i, j : (E,) int64
        From, to.
    T_i_j : (E, k, k) float64
        Measured.
    information : (E, d, d) float64
        Information of the residual ``Log(T_i_j^-1 T)``.
    """

    i: Indices
    j: Indices
    T_i_j: Array
    information: Array

    def __post_init__(self) -> None:
        freeze(self)


def agreeing(
    ops: ModuleType, T: Array, trusted: Stretch, doubtful: Stretch, threshold: float, *, hops: int = 5
) -> Indices:
    """Return for every doubtful measurement how many others agree with it, (E,).

    Parameters
    ----------
    ops : module
        `heliograph.lie.se2` or `se3`.
    T : (n, k, k) float64
        Poses that fit the trusted measurements; only short stretches of them are used.
    trusted, doubtful : Stretch
        Measurements.
    threshold : float
        Threshold of the squared whitened difference of two.
    hops : int
        Trusted measurements between the ends of two, at most.
    """
    count = np.zeros(len(doubtful.i), dtype=np.int64)
    if len(count) < 2 or not len(trusted.i):
        return count
    n, d = len(T), doubtful.information.shape[-1]
    swap = doubtful.i > doubtful.j
    a, b = np.minimum(doubtful.i, doubtful.j), np.maximum(doubtful.i, doubtful.j)
    Z = np.where(swap[:, None, None], ops.inverse(doubtful.T_i_j), doubtful.T_i_j)
    # Log(Z X^-1) = -Ad(Z) Log(Z^-1 X): the residual of a measurement turned round, hence its information.
    Ad = ops.adjoint(Z)
    turned = np.swapaxes(Ad, 1, 2) @ doubtful.information @ Ad
    omega = np.where(swap[:, None, None], turned, doubtful.information)
    step = np.linalg.pinv(np.median(trusted.information, axis=0), hermitian=True)
    drift = np.einsum("nij,ji->n", omega, step) / d  # variance of one trusted hop, in units of the measurement's own
    near = _neighbours(n, trusted.i, trusted.j, np.unique(np.concatenate([a, b])), hops)
    code = a * n + b
    order = np.argsort(code, kind="stable")
    T_inverse = ops.inverse(T)
    for first, last in _chunks(near, a, b):
        k, ends_a, ends_b, path = _queries(near, a, b, first, last)
        for query, other in _found(code[order], ends_a * n + ends_b):
            others = k[query] != order[other]
            m, o, length = k[query][others], order[other][others], path[query][others]
            there = (T_inverse[a[m]] @ T[a[o]]) @ Z[o] @ (T_inverse[b[o]] @ T[b[m]])
            r = ops.log(ops.inverse(Z[m]) @ there)
            squared = np.einsum("ni,nij,nj->n", r, omega[m], r)
            np.add.at(count, m, squared <= threshold * (2.0 + length * drift[m]))
    return count


@dataclass(frozen=True, slots=True, kw_only=True)
class _Near:
    """Variables within some hops of roots, in compressed rows over all variables: (n + 1), (M,), (M,)."""

    offset: Indices
    node: Indices
    hops: Indices

    def __post_init__(self) -> None:
        freeze(self)


def _neighbours(n: int, i: Indices, j: Indices, roots: Indices, hops: int) -> _Near:
    """Return what lies within ``hops`` trusted measurements of each root, itself included."""
    start = np.concatenate([i, j])
    order = np.argsort(start, kind="stable")
    adjacent = np.concatenate([j, i])[order]
    offset = np.searchsorted(start[order], np.arange(n + 1))
    seen, length = roots * n + roots, np.zeros(len(roots), dtype=np.int64)
    front = seen
    for hop in range(1, hops + 1):
        root, node = np.divmod(front, n)
        times = offset[node + 1] - offset[node]
        place = np.arange(int(times.sum())) - np.repeat(np.cumsum(times) - times, times)
        reached = np.unique(np.repeat(root, times) * n + adjacent[np.repeat(offset[node], times) + place])
        front = reached[~np.isin(reached, seen)]
        seen, length = np.concatenate([seen, front]), np.concatenate([length, np.full(len(front), hop)])
    order = np.argsort(seen, kind="stable")
    root, node = np.divmod(seen[order], n)
    return _Near(offset=np.searchsorted(root, np.arange(n + 1)), node=node, hops=length[order])


def _chunks(near: _Near, a: Indices, b: Indices) -> list[tuple[int, int]]:
    """Return ranges of measurements whose pairs of neighbours fit into memory."""
    reach = np.diff(near.offset)
    total = np.cumsum(reach[a] * reach[b])
    ends = [0]
    while ends[-1] < len(a):
        base = total[ends[-1] - 1] if ends[-1] else 0
        ends.append(max(ends[-1] + 1, int(np.searchsorted(total, base + _PAIRS, side="right"))))
    return list(itertools.pairwise(ends))


def _queries(near: _Near, a: Indices, b: Indices, first: int, last: int) -> tuple[Indices, Indices, Indices, Indices]:
    """Return measurement, the two ends and the hops of every pair of neighbours of its ends."""
    k = np.arange(first, last)
    reach = np.diff(near.offset)
    times = reach[a[k]] * reach[b[k]]
    place = np.arange(int(times.sum())) - np.repeat(np.cumsum(times) - times, times)
    k = np.repeat(k, times)
    one, two = np.divmod(place, reach[b[k]])
    one, two = near.offset[a[k]] + one, near.offset[b[k]] + two
    return k, near.node[one], near.node[two], near.hops[one] + near.hops[two]


def _found(codes: Indices, queries: Indices) -> list[tuple[Indices, Indices]]:
    """Return, repeat by repeat, which queries are among the sorted codes, and where."""
    low, high = np.searchsorted(codes, queries), np.searchsorted(codes, queries, side="right")
    repeats = int((high - low).max()) if len(queries) else 0
    return [(hit, low[hit] + shift) for shift in range(repeats) if len(hit := np.flatnonzero(low + shift < high))]
