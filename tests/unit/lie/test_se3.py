import numpy as np
import pytest
from scipy.linalg import expm

from heliograph.errors import DataError
from heliograph.lie import S2, SE2, SE3, SO3, se2, se3, so3


def test_tangent_order_is_rotation_first():
    np.testing.assert_allclose(se3.exp([0, 0, 0, 1, 2, 3])[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(se3.exp([0, 0, np.pi / 2, 0, 0, 0]) @ [1, 0, 0, 1], [0, 1, 0, 1], atol=1e-15)


def test_exp_is_the_matrix_exponential(rng):
    for xi in rng.normal(size=(5, 6)):
        np.testing.assert_allclose(se3.exp(xi), expm(se3.hat(xi)), atol=1e-14)
        np.testing.assert_allclose(se2.exp(xi[:3]), expm(se2.hat(xi[:3])), atol=1e-14)


def test_a_quarter_circle_ends_where_geometry_says():
    # Driving forward 1 m/s while turning left a quarter turn: radius 2 / pi times the arc's length.
    radius = 2.0 / np.pi
    np.testing.assert_allclose(se3.exp([0, 0, np.pi / 2, 1, 0, 0])[:2, 3], [radius, radius], atol=1e-15)
    np.testing.assert_allclose(se2.exp([np.pi / 2, 1, 0])[:2, 2], [radius, radius], atol=1e-15)


def test_act_of_one_motion_on_many_points(rng):
    T, p = se3.exp(rng.normal(size=6)), rng.normal(size=(7, 3)).astype(np.float32)
    expected = (T @ np.column_stack([p, np.ones(7)]).T).T[:, :3]
    np.testing.assert_allclose(se3.act(T, p), expected, atol=1e-12)
    assert se3.act(T, p).dtype == np.float64


def test_act_of_a_batch_pairs_motions_with_points(rng):
    T, p = se3.exp(rng.normal(size=(7, 6))), rng.normal(size=(7, 3))
    np.testing.assert_allclose(se3.act(T, p), [se3.act(a, b) for a, b in zip(T, p, strict=True)])


def test_inverse_keeps_digits_far_out():
    T = se3.from_rotation_translation(so3.exp([0.3, -0.2, 2.0]), [1e6, -2e6, 3e5])
    np.testing.assert_allclose(T @ se3.inverse(T), np.eye(4), atol=1e-8)


def test_from_rotation_translation_broadcasts():
    assert se3.from_rotation_translation(np.eye(3), np.zeros((5, 3))).shape == (5, 4, 4)
    assert se3.from_rotation_translation(np.tile(np.eye(3), (5, 1, 1)), np.zeros(3)).shape == (5, 4, 4)


def test_values_compose_act_and_slice(rng):
    T_a_b, T_b_c = SE3.exp(rng.normal(size=6)), SE3.exp(rng.normal(size=(4, 6)))
    T_a_c = T_a_b @ T_b_c
    assert len(T_a_c) == 4
    np.testing.assert_allclose(T_a_c[2].matrix, T_a_b.matrix @ T_b_c.matrix[2])
    np.testing.assert_allclose(T_a_b @ np.array([1.0, 2.0, 3.0]), se3.act(T_a_b.matrix, [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(T_a_b.retract(T_a_b.local(T_b_c[0])).matrix, T_b_c[0].matrix, atol=1e-14)


def test_values_do_not_change_with_the_array_they_came_from():
    m = np.eye(4)
    T = SE3(m)
    m[0, 3] = 5.0
    assert T.translation[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        T.matrix[0, 3] = 1.0


def test_values_refuse_the_wrong_shape():
    with pytest.raises(DataError, match=r"matrix of SE3 has shape \(3, 3\)"):
        SE3(np.eye(3))
    with pytest.raises(DataError, match="array of points for SE3"):
        SE3.identity() @ np.zeros((3, 4))
    with pytest.raises(TypeError):
        SE3.identity() @ SO3.identity()
    with pytest.raises(TypeError, match="no length"):
        len(SE2.identity())


def test_direction_is_made_unit_and_refuses_zero():
    np.testing.assert_allclose(S2([0, 0, -9.81]).vector, [0, 0, -1])
    with pytest.raises(DataError, match="non-zero"):
        S2([0.0, 0.0, 0.0])


def test_direction_retracts_by_the_angle():
    down = S2([0, 0, -1])
    tilted = down.retract([0.3, 0.4])
    assert np.arccos(tilted.vector @ down.vector) == pytest.approx(0.5)
    np.testing.assert_allclose(down.local(tilted), [0.3, 0.4], atol=1e-15)


def test_direction_basis_is_smooth_around_down(rng):
    for x in np.vstack([[0, 0, -1.0], rng.normal(size=(50, 3))]):
        down = x / np.linalg.norm(x)
        if down[2] > 0.8:
            continue
        nearby = S2(down + 1e-7 * rng.normal(size=3))
        np.testing.assert_allclose(S2(down).basis(), nearby.basis(), atol=1e-5)
