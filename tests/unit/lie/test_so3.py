import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heliograph.errors import DataError
from heliograph.lie import so3


def test_hat_is_the_cross_product(rng):
    a, b = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose((so3.hat(a) @ b[..., None])[..., 0], np.cross(a, b))
    np.testing.assert_array_equal(so3.vee(so3.hat(a)), a)


def test_exp_and_log_agree_with_scipy(rng):
    phi = rng.normal(size=(50, 3))
    np.testing.assert_allclose(so3.exp(phi), Rotation.from_rotvec(phi).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(so3.log(so3.exp(phi)), Rotation.from_rotvec(phi).as_rotvec(), atol=1e-14)


def test_quaternion_order_is_xyzw_as_in_scipy(rng):
    q = rng.normal(size=(50, 4))
    np.testing.assert_allclose(so3.from_quaternion(q), Rotation.from_quat(q).as_matrix(), atol=1e-15)
    canonical = Rotation.from_quat(q).as_quat(canonical=True)
    np.testing.assert_allclose(so3.to_quaternion(so3.from_quaternion(q)), canonical, atol=1e-15)


def test_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(so3.exp([0.0, 0.0, np.pi / 2]) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-16)
    np.testing.assert_allclose(
        so3.from_quaternion([0, 0, np.sqrt(0.5), np.sqrt(0.5)]) @ [1, 0, 0], [0, 1, 0], atol=1e-15
    )


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.0, 0.8], [-0.6, 0.48, 0.64]])
def test_log_of_a_half_turn_is_the_axis(axis):
    v = np.asarray(axis, dtype=float)
    R = 2.0 * np.outer(v, v) - np.eye(3)
    found = so3.log(R)
    assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-15)
    np.testing.assert_allclose(np.abs(found @ v), np.pi, atol=1e-14)


def test_log_of_the_identity_is_zero():
    np.testing.assert_array_equal(so3.log(np.eye(3)), np.zeros(3))


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_from_quaternion_refuses_what_is_no_rotation(bad):
    with pytest.raises(DataError, match="quaternion"):
        so3.from_quaternion(bad)


def test_project_returns_the_nearest_rotation(rng):
    M = so3.exp(rng.normal(size=3)) + 0.1 * rng.normal(size=(3, 3))
    R = so3.project(M)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    for axis in np.eye(3):
        for step in (-1e-3, 1e-3):
            assert np.linalg.norm(R @ so3.exp(step * axis) - M) > np.linalg.norm(R - M)


def test_project_of_a_reflection_is_a_rotation(rng):
    M = np.diag([1.0, 1.0, -1.0]) @ so3.exp(rng.normal(size=(4, 3)))
    np.testing.assert_allclose(np.linalg.det(so3.project(M)), 1.0)


def test_from_two_vectors_takes_the_smallest_turn():
    R = so3.from_two_vectors([2.0, 0.0, 0.0], [0.0, 3.0, 0.0])
    np.testing.assert_allclose(so3.log(R), [0.0, 0.0, np.pi / 2], atol=1e-15)
    np.testing.assert_allclose(so3.from_two_vectors([1, 2, 3], [1, 2, 3]), np.eye(3), atol=1e-15)


@pytest.mark.parametrize("v", [[0, 0, 1], [1, 0, 0], [0, -1, 0], [0.3, -0.4, 0.5]])
def test_from_two_vectors_of_opposites_is_half_a_turn(v):
    R = so3.from_two_vectors(v, -np.asarray(v, dtype=float))
    np.testing.assert_allclose(R @ v, -np.asarray(v), atol=1e-15)
    assert np.linalg.norm(so3.log(R)) == pytest.approx(np.pi)


def test_from_two_vectors_refuses_zero():
    with pytest.raises(DataError, match="non-zero"):
        so3.from_two_vectors([0, 0, 0], [1, 0, 0])


def test_rpy_round_trip_agrees_with_scipy(rng):
    rpy = rng.uniform(-1.5, 1.5, size=(40, 3))
    R = so3.from_rpy(*rpy.T)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(so3.to_rpy(R), rpy, atol=1e-14)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_rpy_at_the_gimbal_lock_still_gives_the_rotation(pitch):
    R = so3.from_rpy(0.4, pitch, 1.0)
    rpy = so3.to_rpy(R)
    assert rpy[0] == 0.0
    np.testing.assert_allclose(so3.from_rpy(*rpy), R, atol=1e-9)


def test_functions_take_lists_and_keep_batch_axes():
    phi = np.zeros((2, 0, 4, 3))
    assert so3.exp(phi).shape == (2, 0, 4, 3, 3)
    assert so3.log(so3.exp(phi)).shape == phi.shape
    assert so3.exp([0.0, 0.0, 1.0]).shape == (3, 3)


def test_a_single_vector_gives_the_bits_of_a_batch_of_one_to_rounding(rng):
    phi = rng.normal(size=(20, 3)) * 2.0
    for f in (so3.exp, so3.right_jacobian, so3.left_jacobian_inverse):
        np.testing.assert_allclose(np.stack([f(row) for row in phi]), f(phi), atol=4e-16, rtol=1e-14)
