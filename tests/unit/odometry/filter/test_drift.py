"""The drift of the map's frame: what the error of the pose that placed a map does to a pose that is matched to it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.lie import se3, so3
from heliograph.odometry.filter.drift import MapDrift
from heliograph.testing import numeric_jacobian
from states import random_covariance, random_state


def moved(state, e):
    """A pose after an error of rotation (body) and position (odom)."""
    return se3.from_rotation_translation(state.R_odom_imu @ so3.exp(e[:3]), state.p_odom + e[3:])


def carried_along(placing, matched, e):
    """The error of a pose that stands on a map which an error ``e`` of the placing pose has moved as one piece."""
    T = moved(placing, e) @ se3.inverse(placing.T_odom_imu) @ matched.T_odom_imu
    turn = so3.log(matched.R_odom_imu.T @ T[:3, :3])
    return np.concatenate([turn, T[:3, 3] - matched.p_odom])


def with_pose_covariance(state, P):
    covariance = state.covariance.copy()
    covariance[:6, :6] = P
    return replace(state, covariance=covariance)


@pytest.mark.parametrize("seed", range(4))
def test_drift_is_the_placing_pose_s_error_carried_to_the_matched_pose(seed):
    rng = np.random.default_rng(seed)
    placing, matched = random_state(rng), random_state(rng)
    P = random_covariance(rng, 6, 0.02)
    placing, matched = with_pose_covariance(placing, P), with_pose_covariance(matched, np.zeros((6, 6)))
    drift = MapDrift(0.0)
    drift.grow(placing, 1.0, sigma=0.03, matched=True)
    J = numeric_jacobian(lambda e: carried_along(placing, matched, e), np.zeros(6))
    np.testing.assert_allclose(drift.pose_covariance(matched), J @ P @ J.T, rtol=1e-6, atol=1e-9 * np.abs(J).max() ** 2)
    assert np.abs(J[3:, :3]).max() > 5.0  # the lever arm between both poses


def test_known_ground_adds_nothing_and_the_first_scan_counts_with_the_next(rng):
    state = random_state(rng)
    drift = MapDrift(0.06)
    drift.grow(state, 1.0, sigma=0.03, matched=False)
    own = state.covariance[:6, :6]
    np.testing.assert_allclose(drift.pose_covariance(state), own, rtol=1e-12)
    drift.grow(state, 0.0, sigma=0.03, matched=True)
    once = drift.pose_covariance(state)
    position = 0.06 * 0.03
    np.testing.assert_allclose(once, 2.0 * own + np.diag([(position / 6.0) ** 2] * 3 + [position**2] * 3), rtol=1e-6)
    drift.grow(state, 0.0, sigma=0.03, matched=True)
    np.testing.assert_allclose(drift.pose_covariance(state), once, rtol=1e-12)
    drift.grow(replace(state, covariance=0.0 * state.covariance), 0.5, sigma=0.0, matched=True)
    np.testing.assert_allclose(drift.pose_covariance(state), once, rtol=1e-12)
