"""Factors on every pose that are replaced from time to time, as all fixes of a drive are: the tree stays thin."""

import numpy as np

from heliograph.graph import ISAM2, Between, FactorGraph, Isotropic, Prior, Symbol, Values, solve
from heliograph.lie import SE2

X, B, E = Symbol("X"), Symbol("B"), Symbol("E")
STEP = SE2.exp([0.1, 1.0, 0.0])
NOISE = Isotropic(0.1)
POSES = 109  # the last are followed by a replacement


def added(k):
    """Pose k of a chain that has a second chain beside it, as velocities and biases are."""
    graph, values = FactorGraph(), Values()
    values.insert(X(k), SE2.exp([0.0, 1.0 * k, 0.0]))
    values.insert(B(k), SE2.identity())
    if k == 0:
        graph.add(Prior(X(0), SE2.identity(), NOISE))
        graph.add(Prior(B(0), SE2.identity(), NOISE))
    else:
        graph.add(Between(X(k - 1), X(k), STEP, NOISE))
        graph.add(Between(B(k - 1), B(k), SE2.identity(), NOISE))
    graph.add(Between(B(k), X(k), SE2.exp([0.0, 1.0 * k, 0.0]), Isotropic(10.0)))
    return graph, values


def seen(count, frame):
    """Every pose so far is seen from one variable, which those factors bring."""
    graph = FactorGraph()
    if frame:
        graph.add(Prior(E(0), SE2.identity(), NOISE))
    k = np.arange(count)
    seen_at = SE2(np.stack([SE2.exp([0.0, 1.0 * i, 0.0]).matrix for i in k]))
    graph.add(Between(np.full(count, int(E(0))), X(k), seen_at, Isotropic(5.0)))
    return graph


def test_replacing_factors_on_all_poses_does_not_fill_the_tree():
    smoother, whole = ISAM2(), FactorGraph()
    due, numbers = 10, np.zeros(0, dtype=np.int32)
    for k in range(POSES):
        graph, new = added(k)
        smoother.update(graph, new)
        for group in graph.groups():
            whole.adopt(group)
        if k + 1 != due:
            continue
        due = int(1.5 * due)
        first = Values()
        if not len(numbers):
            first.insert(E(0), SE2.identity())
        last = seen(k + 1, frame=True)
        numbers = smoother.update(last, first if not len(numbers) else None, remove=numbers).factors
    # Ordered with all poses last, the second chain joins them all: a clique of some hundred.
    assert max(len(c.pivots) + len(c.rows) for c in smoother.cliques()) <= 12
    for group in last.groups():
        whole.adopt(group)
    smoother.update(iterate=1e-7)
    values = solve(whole, smoother.estimate()).values
    for k in (0, POSES // 2, POSES - 1):
        np.testing.assert_allclose(smoother.estimate(X(k)).matrix, values.at(int(X(k))).matrix, atol=1e-5)
