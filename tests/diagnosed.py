"""Chains of poses, and what every solver must say of a graph that leaves something free."""

import numpy as np
import pytest

from heliograph.errors import UnderconstrainedError
from heliograph.graph import (
    Between,
    Isotropic,
    Marginals,
    diagnose,
    solve,
)
from heliograph.lie import S2, SE2, SE3, se3

METHODS = ("gn", "lm", "dogleg")


def steps(rng, lie, count):
    """Relative motions of about a metre forward."""
    xi = 0.2 * rng.normal(size=(count, lie.dof))
    xi[:, lie.dof // 2] += 1.0
    return lie.exp(xi)


def chain(graph, values, keys, lie=SE3, seed=0, noise=None):
    """Poses after one another, from odometry; returned as matrices (N, k, k)."""
    keys = np.asarray(keys)
    Z = steps(np.random.default_rng(seed), lie, len(keys) - 1).matrix
    T = [np.eye(lie.size)]
    for z in Z:
        T.append(T[-1] @ z)
    T = np.array(T)
    values.insert(keys, lie(T))
    graph.add(Between(keys[:-1], keys[1:], lie(Z), noise or Isotropic(0.1)))
    return T


def refusal(graph, values):
    """The diagnosis, after every solver and the marginals refused with the same words."""
    found = diagnose(graph, values)
    assert not found.ok
    for method in METHODS:
        with pytest.raises(UnderconstrainedError) as error:
            solve(graph, values, method)
        assert str(error.value) == found.message
        assert error.value.diagnosis.free[0].text == found.free[0].text
    with pytest.raises(UnderconstrainedError) as error:
        Marginals(graph, values)
    assert str(error.value) == found.message
    return found


def accepted(graph, values, method="lm"):
    assert diagnose(graph, values).ok
    solution = solve(graph, values, method)
    assert solution.status == "converged" and solution.diagnosis.ok
    return solution


def planar():
    T = np.stack([np.eye(3), np.eye(3)])
    c, s = np.cos(0.3), np.sin(0.3)
    T[1] = [[c, -s, 1.0], [s, c, 2.0], [0.0, 0.0, 1.0]]
    return T


def seen_from(T, points):
    p = (se3.inverse(T) @ np.concatenate([points, np.ones((len(points), 1))], axis=1)[:, :, None])[:, :3, 0]
    return S2(p / np.linalg.norm(p, axis=1, keepdims=True))


def planar_chain(count):
    T = [np.eye(3)]
    for z in steps(np.random.default_rng(4), SE2, count - 1).matrix:
        T.append(T[-1] @ z)
    return np.array(T)
