"""Which loops agree with each other: the cycle that two of them close, and the largest set that agrees pair by pair.

References
----------
.. [1] J. Mangelson et al., "Pairwise consistent measurement set maximization for robust multi-robot map merging",
   ICRA 2018.
.. [2] E. Tomita, T. Seki, "An efficient branch-and-bound algorithm for finding a maximum clique", DMTCS 2003.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array, Mask
from heliograph.lie import se3
from heliograph.slam.loops.records import LoopEvidence, RelativePose
from heliograph.slam.loops.tangent import inverse_with_covariance

__all__ = ["cycle_mahalanobis", "maximum_clique"]


def cycle_mahalanobis(a: LoopEvidence, b: LoopEvidence, relative: RelativePose) -> float:
    """Return the squared distance from the identity of the cycle that two loops close with odometry ([1]_ eq. 5).

    The cycle is match a, match b, query b, query a, match a. Chi-square with six degrees of freedom where the two agree
    and the covariances are true.
    """
    T_ma_mb, S_m = _between(a.match, b.match, relative)
    T_qb_qa, S_q = _between(b.query, a.query, relative)
    T_a, T_b = a.T_match_query, b.T_match_query
    rest = T_b @ T_qb_qa @ se3.inverse(T_a)  # mb to ma
    d = se3.log(T_ma_mb @ rest)
    covariance = _carried(S_m, se3.inverse(rest))
    covariance += _carried(b.covariance, T_a @ se3.inverse(T_qb_qa))
    covariance += _carried(S_q + a.covariance, T_a)
    return float(d @ np.linalg.solve(covariance, d))


def maximum_clique(adjacent: Mask) -> tuple[int, ...]:
    """Return the nodes of a largest set that is connected pair by pair, ascending; exact.

    Branch and bound with a bound by greedy colouring ([2]_) on bit sets: nodes of one colour are not connected, so that
    a clique has at most one of each. Near-complete graphs of some hundred nodes, which loops of one run make, take
    milliseconds. Of several largest sets it returns the first found, always the same.

    Parameters
    ----------
    adjacent : (N, N) bool
        Symmetric; the diagonal does not matter.
    """
    n = len(adjacent)
    degrees = np.asarray(adjacent).sum(axis=1)
    order = sorted(range(n), key=lambda k: (-int(degrees[k]), k))
    place = {node: bit for bit, node in enumerate(order)}
    neighbours = [0] * n
    for node in range(n):
        for other in np.flatnonzero(adjacent[node]).tolist():
            if other != node:
                neighbours[place[node]] |= 1 << place[other]
    best: list[int] = []
    stack: list[tuple[list[int], int]] = [([], (1 << n) - 1)]
    while stack:
        chosen, candidates = stack.pop()
        if not candidates:
            best = chosen if len(chosen) > len(best) else best
            continue
        branches = []
        for node, colours in _coloured(candidates, neighbours):
            # Nodes before this one in the colouring are those that a clique which holds it may still take.
            branches.append((node, colours, candidates & neighbours[node]))
            candidates &= ~(1 << node)
        # The node with the most colours is taken first, so it goes onto the stack last.
        stack += [
            ([*chosen, node], left)
            for node, colours, left in reversed(branches)
            if len(chosen) + colours > len(best)
        ]
    return tuple(sorted(order[bit] for bit in best))


def _coloured(candidates: int, neighbours: Sequence[int]) -> list[tuple[int, int]]:
    """Return the candidates with the number of colours that they and all after them in the list need, descending."""
    out, colour = [], 0
    while candidates:
        colour += 1
        free = candidates
        while free:
            bit = free & -free
            node = bit.bit_length() - 1
            out.append((node, colour))
            candidates ^= bit
            free &= ~(bit | neighbours[node])
    out.reverse()
    return out


def _between(first: int, second: int, relative: RelativePose) -> tuple[Array, Array]:
    if first == second:
        return np.eye(4), np.zeros((6, 6))
    if first < second:
        return relative(first, second)
    return inverse_with_covariance(*relative(second, first))


def _carried(covariance: Array, T: Array) -> Array:
    """Covariance of a perturbation that is followed by ``T^-1``."""
    adjoint = se3.adjoint(T)
    return np.asarray(adjoint @ covariance @ adjoint.T)
