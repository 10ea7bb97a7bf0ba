"""A gap costs no work and no memory that grow with it, whatever the stamps say."""

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise, NavState
from heliograph.imu import propagate
from heliograph.odometry.sequencer import Sequencer

NOISE, CONFIG = ImuNoise(gyro=1e-3, accel=1e-2, gyro_walk=1e-5, accel_walk=1e-4), ImuConfig()
SECOND = 10**9


def samples(gap_s):
    """Return a tenth of a second of samples, a gap, and as much again."""
    stamps = np.arange(0, SECOND // 10, SECOND // 200, dtype=np.int64)
    stamps = np.concatenate([stamps, stamps + round(gap_s * SECOND)])
    gyro, accel = np.tile([0.1, 0.0, 0.2], (len(stamps), 1)), np.tile([0.3, 0.0, 9.8], (len(stamps), 1))
    return ImuBatch(stamps_ns=stamps, gyro=gyro, accel=accel, received_ns=int(stamps[-1]))


def state():
    return NavState(
        stamp_ns=0,
        R_odom_imu=np.eye(3),
        p_odom=np.zeros(3),
        v_odom=np.array([1.0, 0.0, 0.0]),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        g_odom=np.array([0.0, 0.0, -9.80665]),
        covariance=1e-6 * np.eye(17),
        T_imu_lidar=np.eye(4),
    )


def test_a_gap_is_one_step_however_long_it_is():
    paths = {}
    for gap in (3.0, 3600.0, 1e5, 3e8):
        imu = samples(gap)
        moved, path = propagate(state(), imu, int(imu.stamps_ns[-1]), noise=NOISE, config=CONFIG)
        paths[gap] = len(path.stamps_ns)
        assert np.isfinite(moved.covariance).all() and np.isfinite(moved.p_odom).all()
        assert path.held_s == pytest.approx(gap - 0.095, abs=1e-3 + 1e-9 * gap)
    assert len(set(paths.values())) == 1 and max(paths.values()) < 120


def test_a_coasted_stretch_is_what_its_parts_are():
    """One step over a gap gives the state and the covariance of many that end within it."""
    imu = samples(20.0)
    end = int(imu.stamps_ns[-1])
    whole, _ = propagate(state(), imu, end, noise=NOISE, config=CONFIG)
    parts = state()
    for stop in (2 * SECOND, 7 * SECOND, 11 * SECOND, end):
        parts, _ = propagate(parts, imu, stop, noise=NOISE, config=CONFIG)
    np.testing.assert_allclose(parts.p_odom, whole.p_odom, rtol=1e-9)
    np.testing.assert_allclose(parts.R_odom_imu, whole.R_odom_imu, atol=1e-12)
    np.testing.assert_allclose(parts.covariance, whole.covariance, rtol=1e-7, atol=1e-9)


def test_dead_reckoning_is_not_cut_all_through_a_gap():
    counts = []
    for gap in (1e3, 1e6, 3e8):
        sequencer = Sequencer(frozenset({"imu"}))
        packets = sequencer.add(samples(gap))
        assert packets[-1].end_ns <= round(gap * SECOND) + SECOND
        counts.append(len(packets))
    assert max(counts) < 10
    short = Sequencer(frozenset({"imu"}))
    assert len(short.add(samples(20.0))) > 190
