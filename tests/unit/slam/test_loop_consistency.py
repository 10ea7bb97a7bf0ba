"""Cliques against brute force, and cycles against a covariance that is counted out by sampling."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam_loops import Chain, loop

from heliograph.lie import se3
from heliograph.slam.loops import cycle_mahalanobis, maximum_clique


def brute_force(adjacent):
    n = len(adjacent)
    for size in range(n, 0, -1):
        for some in itertools.combinations(range(n), size):
            if all(adjacent[i, j] for i, j in itertools.combinations(some, 2)):
                return size
    return 0


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 11), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))
def test_clique_is_as_large_as_brute_force_says(n, density, seed):
    upper = np.triu(np.random.default_rng(seed).random((n, n)) < density, 1)
    adjacent = upper | upper.T
    found = maximum_clique(adjacent)
    assert list(found) == sorted(set(found))
    assert all(adjacent[i, j] for i, j in itertools.combinations(found, 2))
    assert len(found) == brute_force(adjacent)


def test_clique_of_a_large_nearly_complete_graph_is_found(rng):
    n = 120
    upper = np.triu(rng.random((n, n)) < 0.97, 1)
    planted = rng.permutation(n)[:70]
    upper[np.ix_(planted, planted)] = True
    adjacent = np.triu(upper, 1) | np.triu(upper, 1).T
    assert len(maximum_clique(adjacent)) >= 70


def test_two_right_loops_close_their_cycle(rng):
    chain = Chain(60, rng)
    a, b = (loop(q, m, chain.T_true) for q, m in ((50, 3), (55, 7)))
    np.testing.assert_allclose(cycle_mahalanobis(a, [b], Chain(60, rng, sigma=0.0, like=chain)), 0.0, atol=1e-12)


@pytest.mark.parametrize(("qb", "mb"), [(55, 7), (44, 10), (50, 8), (53, 3)])
def test_cycle_is_chi_square_for_right_loops(qb, mb):
    """Mean 6, and as many beyond the 99 % point as there should be; a wrong adjoint shows at once."""
    values = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        chain = Chain(60, rng, turns=True)
        a, b = loop(50, 3, chain.T_true, noise=rng), loop(qb, mb, chain.T_true, noise=rng)
        values.append(float(cycle_mahalanobis(a, [b], chain)[0]))
    assert 5.4 < np.mean(values) < 6.6
    assert np.mean(np.array(values) > 16.81) < 0.035


def test_turn_of_a_loop_counts_at_the_lever_of_the_other(rng):
    """Loops known well in place and badly in turn, queries 12 m apart: most of the error comes by the lever."""
    chain, sigma = Chain(60, rng, sigma=0.0, turns=True), np.repeat([0.02, 0.01], 3)
    values = []
    for seed in range(300):
        noise = np.random.default_rng(seed)
        a, b = (loop(q, m, chain.T_true, noise=noise, sigma=sigma) for q, m in ((50, 3), (38, 15)))
        values.append(float(cycle_mahalanobis(a, [b], chain)[0]))
    assert 5.3 < np.mean(values) < 6.7


def test_loop_to_another_place_does_not_close(rng):
    chain = Chain(60, rng)
    a, wrong = loop(50, 3, chain.T_true), loop(55, 7, chain.T_true, off=se3.exp([0, 0, 0, 3.0, 0, 0]))
    assert cycle_mahalanobis(a, [wrong], chain)[0] > 16.81
    assert len(cycle_mahalanobis(a, [], chain)) == 0
