"""The law of factors holds for right ones and catches wrong ones."""

import numpy as np
import pytest

from heliograph.graph import Factor
from heliograph.lie import S2, SE2, SE3, ExtendedPose, s2, se2, se3
from heliograph.testing import assert_factor


class Between3(Factor):
    variables = (SE3, SE3)
    rows = 6

    @staticmethod
    def residual(T_world_i, T_world_j, T_i_j):
        return se3.log(se3.compose(se3.inverse(T_i_j), se3.compose(se3.inverse(T_world_i), T_world_j)))

    @staticmethod
    def jacobians(T_world_i, T_world_j, T_i_j):
        T_j_i = se3.compose(se3.inverse(T_world_j), T_world_i)
        by_j = se3.right_jacobian_inverse(Between3.residual(T_world_i, T_world_j, T_i_j))
        return -by_j @ se3.adjoint(T_j_i), by_j


class Levelled(Factor):
    """A direction seen from a moving body, with numeric derivatives."""

    variables = (ExtendedPose, S2, 3)
    rows = 3

    @staticmethod
    def residual(X, down_world, bias):
        return np.einsum("nji,nj->ni", X[:, :3, :3], down_world) + bias - X[:, :3, 4]


def poses(rng, count):
    return [se3.exp(rng.normal(size=(count, 6)))]


def world_moved(rng, arrays):
    T_new_world = np.broadcast_to(se3.exp(rng.normal(size=6)), arrays[0].shape)
    return [se3.compose(T_new_world, array) for array in arrays]


@pytest.mark.parametrize("seed", range(3))
def test_right_factors_obey_the_law(seed):
    rng = np.random.default_rng(seed)
    assert_factor(Between3, rng, poses, unchanged_by=world_moved)
    assert_factor(Levelled, rng)


def _left(T_world_i, T_world_j, T_i_j):
    by_j = se3.right_jacobian_inverse(-Between3.residual(T_world_i, T_world_j, T_i_j))
    return Between3.jacobians(T_world_i, T_world_j, T_i_j)[0], by_j


def _near_zero(T_world_i, T_world_j, T_i_j):
    identity = np.broadcast_to(np.eye(6), (len(T_i_j), 6, 6))
    return -se3.adjoint(se3.compose(se3.inverse(T_world_j), T_world_i)), identity


def _centred(T_world_i, T_world_j, T_i_j):
    r = Between3.residual(T_world_i, T_world_j, T_i_j)
    return r - r.mean(axis=0)


def _towards_the_origin(T_world_i, T_world_j, T_i_j):
    r = Between3.residual(T_world_i, T_world_j, T_i_j)
    return r + 0.01 * np.concatenate([T_world_j[:, :3, 3], T_world_i[:, :3, 3]], axis=1)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"jacobians": _left}, "Jacobian of instance 0 by variable 1"),
        ({"jacobians": _near_zero}, "Jacobian of instance 0 by variable 0"),
        ({"residual": _centred}, "alone is not what it is in the batch"),
        ({"residual": lambda i, j, z: Between3.residual(i, j, z)[:, :3]}, "must return shape"),
        ({"residual": lambda i, *_: np.full((len(i), 6), np.nan)}, "not finite"),
    ],
)
def test_law_catches(body, message, rng):
    mutant = type("Mutant", (Between3,), {name: staticmethod(f) for name, f in body.items()})
    with pytest.raises(AssertionError, match=message):
        assert_factor(mutant, rng, poses, unchanged_by=world_moved)


def test_law_catches_a_lost_invariance(rng):
    body = {"variables": (SE3, SE3), "rows": 6, "residual": staticmethod(_towards_the_origin)}
    mutant = type("Mutant", (Factor,), body)
    assert_factor(mutant, rng, poses)
    with pytest.raises(AssertionError, match="should not depend on"):
        assert_factor(mutant, rng, poses, unchanged_by=world_moved)


def test_law_holds_in_the_plane_and_on_the_sphere(rng):
    class Seen(Factor):
        variables = (SE2, 2)
        rows = 2

        @staticmethod
        def residual(T_world_i, p_world, p_i):
            return se2.act(se2.inverse(T_world_i), p_world) - p_i

    class Apart(Factor):
        variables = (S2, S2)
        rows = 1

        @staticmethod
        def residual(a, b):
            return np.einsum("ni,ni->n", a, s2.project(a + 2.0 * b))[:, None]

    assert_factor(Seen, rng, lambda rng, count: [rng.normal(size=(count, 2))])
    assert_factor(Apart, rng)
