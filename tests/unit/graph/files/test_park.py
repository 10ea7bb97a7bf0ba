"""A park is what it says: its noise is honest, and it is the same from the same chance."""

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.graph import Values
from heliograph.graph.files.park import park
from heliograph.graph.problem.problem import Problem


def test_park_has_honest_noise():
    world = park(800, np.random.default_rng(1))
    n = len(world.truth)
    truth = Values()
    truth.insert(np.arange(n), world.truth)
    truth.insert(n + np.arange(len(world.trees)), world.trees)
    problem = Problem(world.file.graph(), truth)
    assert problem.cost().chi2 == pytest.approx(problem.rows, rel=0.1)
    np.testing.assert_array_equal(world.truth.matrix[0], np.eye(3))
    assert 0.2 * n < len(world.pose) < n


def test_park_is_the_same_twice():
    one, two = (park(100, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.p_i, two.p_i) and np.array_equal(one.T_i_j.matrix, two.T_i_j.matrix)


def test_park_without_trees_is_refused():
    with pytest.raises(ConfigError, match="a park needs"):
        park(10, np.random.default_rng(0), trees=0)
