"""The error state's retraction, its inverse, and the Jacobian that moves a covariance, at large errors."""

import numpy as np
import pytest

from heliograph.lie import so3
from heliograph.odometry.filter.error_state import local, reset_jacobian, retract
from heliograph.testing import assert_jacobian
from states import GRAVITY, random_state

OTHER_FIELDS = ("imu_offset", "imu_drift", "wheel_scale")


def large_delta(rng, dim):
    delta = rng.normal(scale=2.0, size=dim)
    for part in (slice(0, 3), slice(17, 20)):
        if part.start < dim:
            delta[part] *= rng.uniform(0.5, 2.8) / np.linalg.norm(delta[part])
    delta[15:17] *= rng.uniform(0.1, 0.6) / np.linalg.norm(delta[15:17])
    return delta


@pytest.mark.parametrize("dim", [17, 23, 25, 26])
@pytest.mark.parametrize("seed", range(5))
def test_local_inverts_retract(seed, dim):
    rng = np.random.default_rng(seed)
    state, delta = random_state(rng, dim=dim), large_delta(rng, dim)
    moved = retract(state, delta)
    np.testing.assert_allclose(local(state, moved), delta, atol=1e-10)
    back = retract(moved, local(moved, state))
    for name in ("R_odom_imu", "p_odom", "v_odom", "gyro_bias", "accel_bias", "g_odom", "T_imu_lidar", *OTHER_FIELDS):
        np.testing.assert_allclose(getattr(back, name), getattr(state, name), atol=1e-10, err_msg=name)


@pytest.mark.parametrize("dim", [17, 23, 25, 26])
@pytest.mark.parametrize("seed", range(5))
def test_reset_jacobian_is_the_derivative_at_large_errors(seed, dim):
    rng = np.random.default_rng(seed)
    state, delta = random_state(rng, dim=dim), large_delta(rng, dim)
    moved = retract(state, delta)
    J = reset_jacobian(state, delta)
    assert_jacobian(lambda e: local(moved, retract(state, delta + e)), np.zeros(dim), J, rtol=1e-6, atol=1e-8)
    assert np.abs(J - np.eye(dim)).max() > 0.1  # or the test would not be about large errors


def test_retract_keeps_what_it_must(rng):
    state = random_state(rng, dim=23)
    moved = retract(state, large_delta(rng, 23))
    assert np.linalg.norm(moved.g_odom) == pytest.approx(GRAVITY, rel=1e-14)
    np.testing.assert_allclose(moved.R_odom_imu.T @ moved.R_odom_imu, np.eye(3), atol=1e-12)
    assert moved.stamp_ns == state.stamp_ns
    assert moved.covariance is state.covariance
    assert not np.shares_memory(moved.T_imu_lidar, state.T_imu_lidar)


def test_rotation_error_is_about_body_axes_and_position_error_along_odom_axes():
    from states import rest_state

    state = retract(rest_state(), np.r_[0.0, 0.0, np.pi / 2, np.zeros(14)])  # faces odom y
    delta = np.r_[0.1, 0.0, 0.0, 1.0, 0.0, 0.0, np.zeros(11)]
    moved = retract(state, delta)
    np.testing.assert_allclose(moved.p_odom, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(so3.log(moved.R_odom_imu @ state.R_odom_imu.T), [0.0, 0.1, 0.0], atol=1e-12)


def test_state_without_gravity_has_no_error_of_its_direction():
    from dataclasses import replace

    from states import rest_state

    state = replace(rest_state(), g_odom=np.zeros(3))
    delta = np.ones(17)
    np.testing.assert_array_equal(retract(state, delta).g_odom, 0.0)
    assert np.isfinite(reset_jacobian(state, delta)).all()
    np.testing.assert_array_equal(local(state, retract(state, delta))[15:], 0.0)
