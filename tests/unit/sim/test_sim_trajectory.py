"""Analytic derivatives against numeric ones, and the shape of the motion."""

import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.sim.trajectory import Course, Gait, SpeedProfile, UniformSpline, WalkedPath

SQUARE = np.array([(4.0, 0.0, 1.0), (9.0, 0.0, 1.0), (9.0, 8.0, 1.6), (0.0, 8.0, 1.6), (0.0, 0.0, 1.0)])
STEP = 1e-5


def path(*, closed=True, gait=None):
    gait = gait or Gait(roll_deg=6.0, pitch_deg=5.0, yaw_deg=9.0, lateral=0.03)
    return WalkedPath(Course(waypoints=SQUARE, corner=1.5, closed=closed), gait, rest=3.0, ramp=2.0, speed=1.2)


def slope(f, t):
    return (f(t + STEP) - f(t - STEP)) / (2.0 * STEP)


@pytest.mark.parametrize("closed", [True, False])
def test_velocity_and_acceleration_are_the_derivatives(closed):
    walk = path(closed=closed)
    t = np.linspace(0.1, walk.profile.stop + 1.0, 1500)
    motion = walk(t)
    np.testing.assert_allclose(motion.v_world, slope(lambda s: walk(s).p_world, t), atol=1e-7)
    np.testing.assert_allclose(motion.a_world, slope(lambda s: walk(s).v_world, t), atol=1e-7)


@pytest.mark.parametrize("closed", [True, False])
def test_body_rate_is_the_derivative_of_the_rotation(closed):
    walk = path(closed=closed)
    t = np.linspace(0.1, walk.profile.stop + 1.0, 1500)
    before, after = walk(t - STEP).R_world_body, walk(t + STEP).R_world_body
    turn = so3.log(np.swapaxes(before, 1, 2) @ after) / (2.0 * STEP)
    np.testing.assert_allclose(walk(t).omega_body, turn, atol=1e-7)


def test_acceleration_has_no_steps():
    walk = path()
    fine = np.linspace(2.9, walk.profile.stop + 0.2, 200_001)
    jumps = np.abs(np.diff(walk(fine).a_world, axis=0)).max()
    assert jumps < 60.0 * (fine[1] - fine[0])  # its slope stays finite where pieces meet


def test_body_rests_before_the_start_and_after_the_stop():
    walk = path()
    for t in (np.linspace(0.0, 3.0, 50), walk.profile.stop + np.linspace(0.0, 2.0, 50)):
        motion = walk(t)
        assert np.abs(motion.v_world).max() < 1e-12
        assert np.abs(motion.a_world).max() < 1e-12
        assert np.abs(motion.omega_body).max() < 1e-12
        np.testing.assert_allclose(motion.p_world, motion.p_world[:1].repeat(50, axis=0), atol=1e-12)


def test_closed_course_ends_in_the_pose_where_it_began():
    walk = path()
    motion = walk(np.array([0.0, walk.profile.stop + 0.5]))
    np.testing.assert_allclose(motion.T_world_body[1], motion.T_world_body[0], atol=1e-9)


def test_gait_has_the_amplitudes_asked_for():
    still = WalkedPath(
        Course(waypoints=np.array([(0.0, 0.0, 1.0), (60.0, 0.0, 1.0)]), corner=1.0, closed=False),
        Gait(bounce=0.02, lateral=0.015, roll_deg=2.0, frequency=1.8),
        rest=1.0,
        ramp=2.0,
        speed=1.5,
    )
    t = np.linspace(5.0, 35.0, 30_001)
    motion = still(t)
    np.testing.assert_allclose(np.abs(motion.p_world[:, 2] - 1.0).max(), 0.02, rtol=1e-3)
    np.testing.assert_allclose(np.abs(motion.p_world[:, 1]).max(), 0.015, rtol=1e-3)
    np.testing.assert_allclose(np.abs(so3.to_rpy(motion.R_world_body)[:, 0]).max(), np.radians(2.0), rtol=1e-3)
    peaks = np.flatnonzero(np.diff(np.sign(np.diff(motion.p_world[:, 2]))) < 0)
    assert len(peaks) / (t[-1] - t[0]) == pytest.approx(1.8, abs=0.05)


def test_spline_reproduces_a_line_and_partitions_unity():
    controls = np.stack([np.arange(12.0) - 2.0, np.ones(12)], axis=1)
    u = np.linspace(0.0, 7.0, 71)
    np.testing.assert_allclose(UniformSpline(controls)(u)[:, 0], u, atol=1e-12)
    np.testing.assert_allclose(UniformSpline(controls)(u)[:, 1], 1.0, atol=1e-12)
    np.testing.assert_allclose(UniformSpline(controls)(u, 1)[:, 0], 1.0, atol=1e-12)


def test_speed_profile_covers_the_distance():
    profile = SpeedProfile(rest=2.0, ramp=1.5, speed=2.0, distance=13.0)
    t = np.array([0.0, 2.0, profile.stop, profile.stop + 5.0])
    np.testing.assert_allclose(2.0 * profile.fraction(t, -1), [0.0, 0.0, 13.0, 13.0], atol=1e-12)
    np.testing.assert_allclose(profile.fraction(t), 0.0, atol=1e-12)


def test_speed_profile_refuses_a_way_too_short_for_its_ramps():
    with pytest.raises(DataError, match="too short"):
        SpeedProfile(rest=0.0, ramp=2.0, speed=1.5, distance=1.0)
