"""The constant-velocity model's noise as the scans show it, and what it leaves in a pose."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import FilterConfig, ImuConfig
from heliograph.data import ImuNoise
from heliograph.odometry.filter.bending import SweepBend
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.filter.unsteadiness import Unsteadiness
from states import rest_state

BENT = SweepBend(turn=0.01, move=0.02, shift=0.05, forgiven=0.1)
LEAST = ImuNoise(gyro=1e-4, accel=3.0, gyro_walk=3.0, accel_walk=0.0)


def moved(state, velocity, rate):
    return replace(state, v_odom=state.v_odom + velocity, gyro_bias=state.gyro_bias - rate)


def test_corrections_of_white_changes_show_their_density(rng):
    state, seen, densities = rest_state(), Unsteadiness(), []
    for _ in range(400):
        after = moved(state, np.sqrt(0.1) * 8.0 * rng.normal(size=3), np.sqrt(0.1) * 5.0 * rng.normal(size=3))
        seen = seen.updated(state, after, 0.1, None)
        densities.append((seen.accel, seen.gyro))
    rms = np.sqrt(np.mean(np.square(densities), axis=0))
    # The running mean, never below the latest: above the truth by less than a half.
    assert 8.0 < rms[0] < 12.0
    assert 5.0 < rms[1] < 7.5


def test_a_jerk_counts_at_once_and_is_forgotten_slowly():
    state = rest_state()
    seen = Unsteadiness().updated(state, moved(state, np.array([3.0, 0.0, 0.0]), np.zeros(3)), 0.1, BENT)
    assert seen.accel == pytest.approx(3.0 / np.sqrt(0.3))
    calm = seen.updated(state, state, 0.1, None)
    assert calm.accel == pytest.approx(np.sqrt(0.9) * seen.accel)
    assert (seen.turn, seen.move) == (BENT.turn, BENT.move)
    assert calm.turn == pytest.approx(np.sqrt(0.9) * BENT.turn)


def test_the_model_is_never_allowed_less_than_configured():
    assert Unsteadiness(accel=0.1, gyro=0.2).allowed(LEAST) == LEAST
    allowed = Unsteadiness(accel=7.0, gyro=0.2).allowed(LEAST)
    assert (allowed.accel, allowed.gyro_walk) == (7.0, 3.0)


def test_bending_that_nothing_measures_is_what_a_line_through_a_random_walk_of_the_rate_misses_at_its_end():
    rng, steps, T, q = np.random.default_rng(3), 400, 0.1, 2.0
    dt = T / steps
    t = dt * np.arange(1, steps + 1)
    rate = np.cumsum(q * np.sqrt(dt) * rng.normal(size=(4000, steps)), axis=1)
    angle = np.cumsum(rate, axis=1) * dt
    line = np.polynomial.polynomial.polyfit(t, angle.T, 1)
    missed = angle[:, -1] - (line[0] + line[1] * T)
    state = rest_state()
    bent = Unsteadiness(gyro=q, accel=0.0).smoothly_bent(state, T)
    added = (bent.covariance - state.covariance)[:6, :6]
    np.testing.assert_allclose(np.sqrt(np.diag(added)[:3]), missed.std(), rtol=0.06)
    np.testing.assert_array_equal(added[3:], 0.0)


def test_bending_leaves_its_square_twice_in_the_pose_and_in_nothing_else():
    """Once for the scan, and once for those that laid the planes it is matched to."""
    state = rest_state()
    seen = Unsteadiness().updated(state, state, 0.1, BENT)
    for share in (0.2, 1.0):
        added = seen.bent(state, share).covariance - state.covariance
        np.testing.assert_allclose(np.diag(added)[:3], 2.0 * share * BENT.turn**2)
        np.testing.assert_allclose(np.diag(added)[3:6], 2.0 * share * BENT.move**2)
        np.testing.assert_array_equal(added[6:], 0.0)


def test_only_the_constant_velocity_model_learns():
    state = rest_state()
    after = moved(state, np.array([9.0, 0.0, 0.0]), np.zeros(3))
    for motion in (MotionModel(ImuConfig(), FilterConfig(), LEAST), MotionModel(ImuConfig(), FilterConfig(), None)):
        assert np.trace(motion.loosened(after, state, 1.0, converged=True).covariance) == 0.0
        motion.learn(state, after, seconds=0.1, bend=BENT)
        loose = motion.loosened(after, state, 1.0, converged=True)
        assert (np.trace(loose.covariance) == 0.0) == motion.inertial


def test_without_a_look_at_the_sweep_nothing_is_known_better_by_what_does_not_settle():
    state = replace(rest_state(), covariance=np.eye(17))
    after = replace(moved(state, np.array([9.0, 0.0, 0.0]), np.zeros(3)), covariance=0.01 * np.eye(17))
    inertial = MotionModel(ImuConfig(), FilterConfig(), LEAST)
    assert inertial.settled(state, after, converged=False, seconds=0.1, sweep=0.1) is after
    alone = MotionModel(ImuConfig(), FilterConfig(), None)
    vague = alone.settled(state, after, converged=False, seconds=0.1, sweep=0.0)
    np.testing.assert_array_equal(vague.covariance, state.covariance)
    known = alone.settled(state, after, converged=True, seconds=0.1, sweep=0.1)
    assert np.trace(known.covariance) > np.trace(after.covariance)


def test_what_does_not_settle_is_known_no_better_than_what_it_was_corrected_by():
    state = rest_state()
    after = moved(state, np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.0]))
    alone = MotionModel(ImuConfig(), FilterConfig(), None)
    added = alone.loosened(after, state, 0.5, converged=False).covariance
    np.testing.assert_allclose(np.diag(added)[6:12], np.repeat([1.5, 0.06], 3), atol=1e-12)
    np.testing.assert_allclose(np.diag(added)[:6], 0.0, atol=1e-12)
