"""Covariances from the Bayes tree against those of a batch factorisation."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import ISAM2, Marginals
from heliograph.lie import SE2, SE3
from reference.growth import NAVIGATION, POINT, STATE, growth, whole


@pytest.fixture(params=[SE2, SE3])
def settled(request, rng):
    steps = growth(request.param, 60, rng)
    smoother = ISAM2()
    for step in steps:
        smoother.update(step.graph(), step.values)
    assert smoother.update(iterate=1e-11).converged
    return smoother, Marginals(whole(steps), smoother.estimate())


def test_marginals_of_old_and_new_variables(settled):
    smoother, batch = settled
    every = np.arange(60)
    np.testing.assert_allclose(smoother.covariance(every), batch.covariance(every), atol=1e-9)
    for keys in (3, [59, 4, 31, 4], POINT + np.arange(12), STATE + 4 * np.arange(15), NAVIGATION + 12):
        found = smoother.covariance(keys)
        np.testing.assert_allclose(found, batch.covariance(keys), atol=1e-9)
        np.testing.assert_allclose(found, np.swapaxes(found, -1, -2), atol=0.0)


def test_one_variable_alone_has_the_covariance_that_it_has_among_others(settled):
    smoother, _ = settled
    for keys in (np.arange(60), POINT + np.arange(12), STATE + 4 * np.arange(15)):
        alone = np.array([smoother.covariance(key) for key in keys])
        np.testing.assert_allclose(alone, smoother.covariance(keys), atol=1e-12, rtol=1e-9)


def test_joint_of_any_variables(settled):
    smoother, batch = settled
    for keys in ([7], [59, 2], [POINT + 1, 33, STATE + 8, NAVIGATION, 1], [5, 0, 6]):
        np.testing.assert_allclose(smoother.joint(keys), batch.joint(keys), atol=1e-9)


def test_joint_of_all_is_the_inverse_of_the_information(settled):
    smoother, batch = settled
    np.testing.assert_allclose(smoother.joint(np.arange(60)), batch.joint(np.arange(60)), atol=1e-9)


def test_held_variables_have_none(settled):
    smoother, _ = settled
    assert not smoother.covariance(0).any()
    assert not smoother.covariance([0, 1])[0].any()
    d = smoother.covariance(1).shape[0]
    joint = smoother.joint([0, 1])
    assert not joint[:d].any()
    np.testing.assert_allclose(joint[d:, d:], smoother.covariance(1), atol=1e-12)


def test_mistakes_are_named(settled):
    smoother, _ = settled
    with pytest.raises(GraphError, match="999"):
        smoother.covariance(999)
    with pytest.raises(GraphError, match="one size at a time"):
        smoother.covariance([1, POINT])
    with pytest.raises(GraphError, match="999"):
        smoother.joint([1, 999])
    assert smoother.covariance([]).shape == (0, 0, 0)
    assert smoother.joint([]).shape == (0, 0)
