"""The drift of the map's frame: what the error of the pose that placed a map does to a pose that is matched to it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.imu import ErrorGrowth
from heliograph.lie import s2, se3, so3
from heliograph.odometry.filter.drift import MapDrift, turned_frame
from heliograph.testing import numeric_jacobian
from states import random_covariance, random_rotation, random_state


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
    drift.grow(placing, 1.0, np.zeros((6, 6)))
    J = numeric_jacobian(lambda e: carried_along(placing, matched, e), np.zeros(6))
    np.testing.assert_allclose(drift.pose_covariance(matched), J @ P @ J.T, rtol=1e-6, atol=1e-9 * np.abs(J).max() ** 2)
    assert np.abs(J[3:, :3]).max() > 5.0  # the lever arm between both poses


def test_known_ground_adds_nothing_and_the_first_scan_counts_with_the_next(rng):
    state = with_pose_covariance(random_state(rng), random_covariance(rng, 6, 0.02))
    state = replace(state, covariance=np.pad(state.covariance[:6, :6], (0, 11)))
    drift, unit = MapDrift(0.06), random_covariance(rng, 6, 0.5)
    drift.begin(1.0)
    own = state.covariance[:6, :6]
    np.testing.assert_allclose(drift.pose_covariance(state), own, rtol=1e-12)
    drift.grow(state, 0.0, unit)
    once = drift.pose_covariance(state)
    np.testing.assert_allclose(once, 2.0 * own + 0.06**2 * unit, rtol=1e-6, atol=1e-12)
    drift.grow(state, 0.0, unit)
    np.testing.assert_allclose(drift.pose_covariance(state), once, rtol=1e-12)
    drift.grow(replace(state, covariance=0.0 * state.covariance), 0.5, 0.0 * unit)
    np.testing.assert_allclose(drift.pose_covariance(state), once, rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_what_is_handed_over_leaves_the_pose_in_the_world_as_uncertain_as_it_was(rng, share):
    """All of the pose or the axis only: the pose is exact in the frame then, and the frame as uncertain as it was."""
    state = random_state(rng)
    axis = np.zeros(6)
    axis[3:] = random_rotation(rng)[:, 0]
    blind = np.eye(6) if share else np.outer(axis, axis)
    drift = MapDrift(0.02)
    drift.grow(state, 0.3, 1e-4 * np.eye(6))
    before = drift.pose_covariance(state)
    state = drift.hand_over(state, blind)
    assert np.abs(blind @ state.covariance[:6, :6]).max() < 1e-12
    np.testing.assert_allclose(drift.pose_covariance(state), before, rtol=1e-7, atol=1e-12)
    again = drift.hand_over(state, blind)  # there is nothing left to hand over
    np.testing.assert_allclose(again.covariance, state.covariance, atol=1e-12)
    np.testing.assert_allclose(drift.pose_covariance(again), before, rtol=1e-7, atol=1e-12)


def test_a_drift_that_is_handed_over_scan_by_scan_is_that_of_the_velocity(rng):
    """Blind along an axis with a velocity that is off: the way's sigma is its sigma times time."""
    state = random_state(rng)
    covariance = np.zeros((17, 17))
    covariance[6:9, 6:9] = 0.1**2 * np.eye(3)
    state, drift, F = replace(state, covariance=covariance), MapDrift(0.0), np.eye(17)
    F[3:6, 6:9] = 0.1 * np.eye(3)
    growth = ErrorGrowth(transition=F, added=np.zeros((17, 17)), clock_shift=None, span=0.1)
    for _ in range(50):
        drift.predicted(growth)
        state = replace(state, covariance=growth.grown(state.covariance))
        state = drift.hand_over(state, np.diag([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    sigma = np.sqrt(np.diag(drift.pose_covariance(state)))[3:]
    np.testing.assert_allclose(sigma, 0.1 * 5.0, rtol=1e-9)  # handed over along x, kept along y and z: it is the same
    retained = np.eye(17)
    retained[6, 6] = 0.0  # the velocity is measured exactly: what it has done stays
    state = replace(state, covariance=retained @ state.covariance @ retained)
    drift.updated(retained)
    drift.predicted(growth)
    assert np.sqrt(drift.pose_covariance(state)[3, 3]) == pytest.approx(0.5)


def test_a_frame_that_turns_leaves_gravity_and_velocity_behind(rng):
    state = random_state(rng)
    numeric = numeric_jacobian(lambda e: _in_turned_frame(state, e), np.zeros(3))
    turned = turned_frame(state)
    np.testing.assert_allclose(turned[6:9, :3], numeric[:3], atol=1e-6)
    np.testing.assert_allclose(turned[15:17, :3], numeric[3:], atol=1e-6)
    assert not turned[:, 3:].any()


def _in_turned_frame(state, e):
    """Errors of velocity and gravity in a frame that has turned by the pose's error e (3,) about body axes."""
    back = state.R_odom_imu @ so3.exp(e).T @ state.R_odom_imu.T
    down = state.g_odom / np.linalg.norm(state.g_odom)
    return np.concatenate([back @ state.v_odom - state.v_odom, s2.local(down, back @ down)])
