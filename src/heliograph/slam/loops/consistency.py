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


def cycle_mahalanobis(
    loop: LoopEvidence, others: Sequence[LoopEvidence], relative: RelativePose, slack: Array | None = None
) -> Array:
    """Return the squared distance from the identity of the cycles that a loop closes with others (N,) ([1]_ eq. 5).

    A cycle is match a, match b, query b, query a, match a. Chi-square with six degrees of freedom where the two loops
    agree and the covariances are true.

    Parameters
    ----------
    loop : LoopEvidence
        Loop a.
    others : sequence of LoopEvidence
        Loops b.
    relative : callable
        Keyframes a < b -> ``T_a_b`` of odometry and its covariance.
    slack : (6, 6) float64, optional
        Covariance of what either loop may be off beyond its own.
    """
    slack = np.zeros((6, 6)) if slack is None else slack
    if not others:
        return np.zeros(0)
    T_ma_mb, S_m = _between([(loop.match, b.match) for b in others], relative)
    T_qb_qa, S_q = _between([(b.query, loop.query) for b in others], relative)
    T_b, S_b = np.stack([b.T_match_query for b in others]), np.stack([b.covariance for b in others])
    rest = T_b @ T_qb_qa @ se3.inverse(loop.T_match_query)  # mb to ma
    d = se3.log(T_ma_mb @ rest)
    covariance = _carried(S_m, se3.inverse(rest))
    covariance += _carried(S_b + slack, loop.T_match_query @ se3.inverse(T_qb_qa))
    covariance += _carried(S_q + loop.covariance + slack, np.broadcast_to(loop.T_match_query, T_b.shape))
    return np.asarray(np.einsum("ni,ni->n", d, np.linalg.solve(covariance, d[..., None])[..., 0]))


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
    best = _greedy(neighbours)
    stack: list[tuple[list[int], int, int]] = [([], (1 << n) - 1, n)]  # chosen, candidates, bound
    while stack:
        chosen, candidates, bound = stack.pop()
        if bound <= len(best):
            continue
        if not candidates:
            best = chosen
            continue
        branches = []
        for node, colours in _coloured(candidates, neighbours):
            # Those left of the colouring are what a clique with this node, and none before it, may still take.
            branches.append(([*chosen, node], candidates & neighbours[node], len(chosen) + colours))
            candidates &= ~(1 << node)
        # The highest bound is looked at first.
        stack += [branch for branch in reversed(branches) if branch[2] > len(best)]
    return tuple(sorted(order[bit] for bit in best))


def _greedy(neighbours: Sequence[int]) -> list[int]:
    """Return a clique that no node could join: the best so far, which prunes near-complete graphs at once."""
    chosen, left = [], (1 << len(neighbours)) - 1
    while left:
        node = (left & -left).bit_length() - 1
        chosen.append(node)
        left &= neighbours[node]
    return chosen


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


def _between(pairs: Sequence[tuple[int, int]], relative: RelativePose) -> tuple[Array, Array]:
    poses, covariances = np.tile(np.eye(4), (len(pairs), 1, 1)), np.zeros((len(pairs), 6, 6))
    for k, (first, second) in enumerate(pairs):
        if first < second:
            poses[k], covariances[k] = relative(first, second)
        elif second < first:
            poses[k], covariances[k] = inverse_with_covariance(*relative(second, first))
    return poses, covariances


def _carried(covariances: Array, T: Array) -> Array:
    """Covariances of perturbations that are followed by ``T^-1``, (N, 6, 6)."""
    adjoint = se3.adjoint(T)
    return np.asarray(adjoint @ covariances @ np.swapaxes(adjoint, -1, -2))
