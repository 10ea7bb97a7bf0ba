"""The constant-velocity model's noise as the scans show it, and what it leaves in a pose."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import FilterConfig, ImuConfig
from heliograph.data import ImuNoise
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.filter.unsteadiness import Unsteadiness
from states import rest_state

LEAST = ImuNoise(gyro=1e-4, accel=3.0, gyro_walk=3.0, accel_walk=0.0)


def moved(state, velocity, rate):
    return replace(state, v_odom=state.v_odom + velocity, gyro_bias=state.gyro_bias - rate)


def test_corrections_of_white_changes_show_their_density(rng):
    state, seen, densities = rest_state(), Unsteadiness(), []
    for _ in range(400):
        after = moved(state, np.sqrt(0.1) * 8.0 * rng.normal(size=3), np.sqrt(0.1) * 5.0 * rng.normal(size=3))
        seen = seen.updated(state, after, 0.1)
        densities.append((seen.accel, seen.gyro))
    rms = np.sqrt(np.mean(np.square(densities), axis=0))
    # The running mean, never below the latest: above the truth by less than a half.
    assert 8.0 < rms[0] < 12.0
    assert 5.0 < rms[1] < 7.5


def test_a_jerk_counts_at_once_and_is_forgotten_slowly():
    state = rest_state()
    seen = Unsteadiness().updated(state, moved(state, np.array([3.0, 0.0, 0.0]), np.zeros(3)), 0.1)
    assert seen.accel == pytest.approx(3.0 / np.sqrt(0.3))
    calm = seen.updated(state, state, 0.1)
    assert calm.accel == pytest.approx(np.sqrt(0.9) * seen.accel)


def test_the_model_is_never_allowed_less_than_configured():
    assert Unsteadiness(accel=0.1, gyro=0.2).allowed(LEAST) == LEAST
    allowed = Unsteadiness(accel=7.0, gyro=0.2).allowed(LEAST)
    assert (allowed.accel, allowed.gyro_walk) == (7.0, 3.0)


def test_bending_is_what_a_line_through_a_random_walk_of_the_rate_misses_at_its_end():
    rng, steps, T, q = np.random.default_rng(3), 400, 0.1, 2.0
    dt = T / steps
    t = dt * np.arange(1, steps + 1)
    rate = np.cumsum(q * np.sqrt(dt) * rng.normal(size=(4000, steps)), axis=1)
    angle = np.cumsum(rate, axis=1) * dt
    line = np.polynomial.polynomial.polyfit(t, angle.T, 1)
    missed = angle[:, -1] - (line[0] + line[1] * T)
    state = rest_state()
    bent = Unsteadiness(gyro=q, accel=0.0).bent(state, T)
    added = (bent.covariance - state.covariance)[:6, :6]
    np.testing.assert_allclose(np.sqrt(np.diag(added)[:3]), missed.std(), rtol=0.06)
    np.testing.assert_array_equal(added[3:], 0.0)


def test_only_the_constant_velocity_model_learns(rng):
    state = rest_state()
    after = moved(state, np.array([9.0, 0.0, 0.0]), np.zeros(3))
    inertial = MotionModel(ImuConfig(), FilterConfig(), LEAST)
    assert inertial.settled(state, after, converged=True, seconds=0.1, sweep=0.1) is after
    alone = MotionModel(ImuConfig(), FilterConfig(), None)
    vague = alone.settled(
        replace(state, covariance=4.0 * state.covariance), after, converged=False, seconds=0.1, sweep=0.0
    )
    np.testing.assert_array_equal(vague.covariance, 4.0 * state.covariance)
    assert np.trace(alone.settled(state, after, converged=True, seconds=0.1, sweep=0.1).covariance) > np.trace(
        after.covariance
    )
