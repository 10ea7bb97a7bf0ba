import numpy as np
import pytest

from heliograph.lie import SE3, interpolate_se3, se3, so3


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 0.1, 2.0, np.pi])
def test_so3_log_undoes_exp(angle):
    phi = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    np.testing.assert_allclose(so3.log(so3.exp(phi)), phi, rtol=1e-12)


def test_interpolation_halfway_is_half_the_twist():
    xi = np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0])
    T = interpolate_se3([0, 10], np.stack([np.eye(4), se3.exp(xi)]), [0, 5, 10])
    np.testing.assert_allclose(se3.log(T), [0.0 * xi, 0.5 * xi, xi], atol=1e-14)


def test_motion_composes_and_acts():
    T = SE3.exp([0.0, 0.0, np.pi / 2, 1.0, 0.0, 0.0])
    p = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose((T @ T.inverse()) @ p, p, atol=1e-15)
