"""The laws of the Lie groups, and that the laws catch a wrong group."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.lie import SE2, SE3, SO2, SO3, ExtendedPose, s2, se3, so3
from heliograph.testing import assert_jacobian, assert_lie_group

GROUPS = [SO2, SO3, SE2, SE3, ExtendedPose]


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("seed", range(3))
def test_group_obeys_the_laws(group, seed):
    assert_lie_group(group, np.random.default_rng(seed))


def _with(method, function, base=SE3):
    return type("Broken", (base,), {method: function})


def _one_turn_more(phi):
    """Return another logarithm of the same rotation, longer by a full turn."""
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    return phi * (1.0 + 2.0 * np.pi / np.where(angle > 0.0, angle, np.inf))


MUTANTS = {
    "left instead of right Jacobian": _with(
        "right_jacobian", staticmethod(lambda x: se3.right_jacobian(-np.asarray(x)))
    ),
    "first-order inverse": _with(
        "right_jacobian_inverse", staticmethod(lambda x: se3.right_jacobian(-np.asarray(x) / 2))
    ),
    "adjoint of the inverse": _with("adjoint", lambda self: se3.adjoint(se3.inverse(self.matrix))),
    "log without the arc": _with(
        "log", lambda self: np.concatenate([so3.log(self.matrix[..., :3, :3]), self.matrix[..., :3, 3]], axis=-1)
    ),
    "log a turn too far": _with("log", lambda self: _one_turn_more(so3.log(self.matrix)), SO3),
    "left perturbation": _with("retract", lambda self, d: type(self)(se3.exp(d) @ self.matrix)),
    "small rotations lost": _with(
        "log", lambda self: np.where(np.abs(se3.log(self.matrix)) < 1e-8, 0.0, se3.log(self.matrix))
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_laws_catch(name, rng):
    with pytest.raises(AssertionError):
        assert_lie_group(MUTANTS[name], rng)


finite = st.floats(-1.0, 1.0)
direction = st.tuples(finite, finite, finite).filter(lambda v: np.linalg.norm(v) > 1e-3)
angle = st.one_of(
    st.floats(0.0, np.pi), st.floats(0.0, 1e-6), st.floats(0.0, 1e-6).map(lambda e: np.pi - e), st.just(np.pi)
)


@given(direction, angle)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_so3_log_inverts_exp_everywhere(axis, angle):
    phi = np.asarray(axis) / np.linalg.norm(axis) * angle
    R = so3.exp(phi)
    np.testing.assert_allclose(so3.exp(so3.log(R)), R, atol=1e-15 * 8)
    np.testing.assert_allclose(np.linalg.norm(so3.log(R)), angle, rtol=1e-12, atol=4e-16)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=2e-15)
    if angle < np.pi - 1e-12:
        np.testing.assert_allclose(so3.log(R), phi, rtol=0, atol=1e-14 * max(angle, 1e-2))


@given(direction, angle, st.floats(0.0, 1e-7))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_so3_log_survives_a_matrix_that_is_not_quite_a_rotation(axis, angle, size):
    phi = np.asarray(axis) / np.linalg.norm(axis) * angle
    R = so3.exp(phi)
    bent = R + size * np.array([[1.0, -0.5, 0.2], [0.3, 1.0, -0.7], [-0.9, 0.4, -1.0]])
    np.testing.assert_allclose(so3.exp(so3.log(bent)), R, atol=1e-14 + 6 * size)


@given(direction, angle)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_so3_quaternion_round_trip(axis, angle):
    R = so3.exp(np.asarray(axis) / np.linalg.norm(axis) * angle)
    q = so3.to_quaternion(R)
    assert q[3] >= 0.0
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-15)
    np.testing.assert_allclose(so3.from_quaternion(q * 3.0), R, atol=1e-15 * 4)


@given(direction, direction)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_so3_from_two_vectors_turns_one_into_the_other(a, b):
    R = so3.from_two_vectors(a, b)
    np.testing.assert_allclose(R @ s2.project(a), s2.project(b), atol=1e-11)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)


@given(direction, direction)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_s2_local_inverts_retract(a, b):
    x, y = s2.project(a), s2.project(b)
    np.testing.assert_allclose(s2.retract(x, s2.local(x, y)), y, atol=2e-14)


@given(direction, st.floats(1e-12, 3.1), st.floats(-np.pi, np.pi))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_s2_retract_inverts_local(a, length, heading):
    x, d = s2.project(a), length * np.array([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(s2.local(x, s2.retract(x, d)), d, rtol=0.0, atol=2e-15 + 1e-13 * length)


@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-3, 0.4, 1.9, 2.1, 3.0])
def test_s2_retract_jacobian_is_the_derivative(length, rng):
    for x in s2.project(rng.normal(size=(8, 3))):
        d = length * np.array([0.6, -0.8])
        assert_jacobian(lambda e, x=x: s2.retract(x, e), d, s2.retract_jacobian(x, d), atol=1e-10)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 2.0, 3.0])
def test_so3_left_jacobian_is_the_derivative_on_the_left(angle, rng):
    phi = s2.project(rng.normal(size=3)) * angle
    R_inverse = so3.inverse(so3.exp(phi))
    assert_jacobian(lambda y: so3.log(so3.exp(y) @ R_inverse), phi, so3.left_jacobian(phi), atol=1e-10)
    np.testing.assert_allclose(so3.left_jacobian(phi) @ so3.left_jacobian_inverse(phi), np.eye(3), atol=1e-13)
