"""Which doubtful measurements are borne out, against a pair-by-pair count."""

import numpy as np
import pytest

from heliograph.graph.batch.support import Stretch, agreeing
from heliograph.lie import SE2, SE3


def _pairs(group, T, doubtful, step, threshold, hops):
    """Return how many others agree with each measurement, along a chain: slow and obvious."""
    d = group.dof
    ends = []
    for i, j, Z, omega in zip(doubtful.i, doubtful.j, doubtful.T_i_j, doubtful.information, strict=True):
        Z = group(Z)
        if i > j:
            Ad = Z.inverse().adjoint()
            X = Z.retract(np.linspace(-0.5, 0.7, d))
            r, turned = (Z.inverse() @ X).log(), (Z @ X.inverse()).log()
            i, j, Z, former, omega = j, i, Z.inverse(), omega, Ad.T @ omega @ Ad
            assert turned @ omega @ turned == pytest.approx(r @ former @ r)
        ends.append((i, j, Z, omega))
    count = np.zeros(len(ends), dtype=int)
    for k, (a, b, Z, omega) in enumerate(ends):
        for m, (a2, b2, Z2, _) in enumerate(ends):
            if m == k or abs(a - a2) > hops or abs(b - b2) > hops:
                continue
            around = T[int(a)].inverse() @ T[int(a2)] @ Z2 @ T[int(b2)].inverse() @ T[int(b)]
            r = (Z.inverse() @ around).log()
            drift = np.trace(omega @ step) / d
            count[k] += r @ omega @ r <= threshold * (2.0 + (abs(a - a2) + abs(b - b2)) * drift)
    return count


@pytest.mark.parametrize("group", [SE2, SE3])
def test_agreeing_counts_pairs_around_short_loops(group, rng):
    n, d = 40, group.dof
    steps = group.exp(rng.normal(size=(n - 1, d)) * 0.4)
    T = [group.identity()]
    for k in range(n - 1):
        T.append(T[-1] @ steps[k])
    T = group(np.stack([pose.matrix for pose in T]))
    step_noise = np.diag(np.full(d, 0.02**2))
    trusted = Stretch(
        i=np.arange(n - 1),
        j=np.arange(1, n),
        T_i_j=steps.matrix,
        information=np.tile(np.linalg.inv(step_noise), (n - 1, 1, 1)),
    )
    i, j = rng.integers(0, 12, 60), rng.integers(25, 38, 60)
    i[:20], j[:20] = j[:20].copy(), i[:20].copy()
    i[30], j[30] = i[31], j[31]  # one pair of places measured twice
    Z = (T[i].inverse() @ T[j]).retract(0.05 * rng.normal(size=(60, d)))
    Z = np.where((rng.random(60) < 0.4)[:, None, None], group.exp(rng.normal(size=(60, d))).matrix, Z.matrix)
    root = 10.0 * (np.eye(d) + 0.3 * rng.normal(size=(60, d, d)))
    doubtful = Stretch(i=i, j=j, T_i_j=Z, information=np.swapaxes(root, 1, 2) @ root)
    found = agreeing(group.ops, T.matrix, trusted, doubtful, 5.0, hops=3)
    np.testing.assert_array_equal(found, _pairs(group, T, doubtful, step_noise, 5.0, 3))
    assert 0 < (found > 0).sum() < 60


def test_agreeing_needs_another_measurement_and_something_trusted(rng):
    none = np.zeros(0, dtype=np.int64)
    empty = Stretch(i=none, j=none, T_i_j=np.zeros((0, 3, 3)), information=np.zeros((0, 3, 3)))
    Z = SE2.exp(rng.normal(size=(2, 3))).matrix
    two = Stretch(i=np.array([0, 0]), j=np.array([1, 1]), T_i_j=Z, information=np.tile(np.eye(3), (2, 1, 1)))
    T = SE2.identity((2,)).matrix
    np.testing.assert_array_equal(agreeing(SE2.ops, T, empty, two, 5.0), [0, 0])
    np.testing.assert_array_equal(agreeing(SE2.ops, T, two, empty, 5.0), [])
