"""The native maps over batches agree with NumPy's for one element, whatever the shape and memory of the batch."""

import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.lie import SE2, SE3, SO3, se2, se3, se23, so3

DOF = {so3: 3, se2: 3, se3: 6}
OF_TANGENT = ["exp", "right_jacobian", "right_jacobian_inverse"]
ANGLES = [0.0, 1e-9, 1e-4, 0.3, 0.7, 0.8, 1.4, 1.6, 2.0, 3.0, np.pi, -3.1, 4.0, 6.0]


def tangents(module, rng):
    x = rng.normal(size=(len(ANGLES), DOF[module]))
    if module is se2:
        x[:, 0] = ANGLES
    else:
        x[:, :3] *= (np.array(ANGLES) / np.linalg.norm(x[:, :3], axis=1))[:, None]
    return x


def one_by_one(function, *batches):
    return np.stack([function(*row) for row in zip(*batches, strict=True)])


@pytest.mark.parametrize("module", DOF, ids=lambda m: m.__name__.rsplit(".", 1)[1])
def test_batch_agrees_with_one(module, rng):
    x = tangents(module, rng)
    names = OF_TANGENT + (["left_jacobian", "left_jacobian_inverse"] if module is so3 else [])
    for name in names:
        f = getattr(module, name)
        expected = one_by_one(f, x)
        np.testing.assert_allclose(f(x), expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max(), err_msg=name)
    X = module.exp(x)
    for name in ["log", "inverse", "adjoint"]:
        f = getattr(module, name)
        np.testing.assert_allclose(f(X), one_by_one(f, X), atol=3e-14 * 10, err_msg=name)
    np.testing.assert_allclose(module.retract(X, x[::-1]), one_by_one(module.retract, X, x[::-1]), atol=1e-13)
    np.testing.assert_allclose(module.local(X, X[::-1]), one_by_one(module.local, X, X[::-1]), atol=1e-12)


@pytest.mark.parametrize("module", [se2, se3])
def test_compose_broadcasts_as_a_product(module, rng):
    X, Y = (module.exp(rng.normal(size=(2, 5, DOF[module]))) for _ in range(2))
    np.testing.assert_allclose(module.compose(X, Y), X @ Y, atol=1e-14)
    np.testing.assert_allclose(module.compose(X[0, 0], Y), X[0, 0] @ Y, atol=1e-14)
    np.testing.assert_allclose(module.compose(X[:, :1], Y), X[:, :1] @ Y, atol=1e-14)


@pytest.mark.parametrize("module", DOF)
def test_any_memory_and_any_leading_axes_will_do(module, rng):
    x = rng.normal(size=(4, 3, DOF[module]))
    X = module.exp(x)
    assert X.shape[:2] == (4, 3)
    np.testing.assert_array_equal(module.exp(x[::2, 1]), X[::2, 1])
    np.testing.assert_array_equal(module.log(X[::-2]), module.log(X)[::-2])
    np.testing.assert_array_equal(module.log(np.asfortranarray(X)), module.log(X))
    np.testing.assert_array_equal(module.log(X.tolist()), module.log(X))
    frozen = X.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(module.inverse(frozen), module.inverse(X))
    assert module.log(X[:0]).shape == (0, 3, DOF[module])


@pytest.mark.parametrize("module", DOF)
def test_a_batch_of_another_group_is_refused(module):
    with pytest.raises(DataError, match=r"shape \(7, 5, 5\), expected real numbers"):
        module.log(np.tile(np.eye(5), (7, 1, 1)))


@pytest.mark.parametrize("group", [SE2, SE3, SO3])
def test_a_number_that_is_none_stays_visible(group):
    x = np.zeros((3, group.dof))
    x[1] = np.nan
    found = group.exp(x).log()
    assert np.isnan(found[1]).any() and not np.isnan(found[[0, 2]]).any()


def test_extended_poses_are_two_motions_with_one_rotation(rng):
    x = rng.normal(size=(6, 9))
    X = se23.exp(x)
    np.testing.assert_allclose(X[:, :4, :4], se3.exp(x[:, :6]), atol=1e-14)
    with_velocity = np.delete(np.delete(X, 3, axis=1), 3, axis=2)
    np.testing.assert_allclose(with_velocity, se3.exp(np.delete(x, [3, 4, 5], axis=1)), atol=1e-14)
    np.testing.assert_allclose(se23.log(X), x, atol=1e-13)
    built = se23.from_rotation_position_velocity(X[:, :3, :3], X[:, :3, 3], X[:, :3, 4])
    np.testing.assert_array_equal(built, X)
