"""A start in motion from positions, and gaps that somebody filled."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu import drop_filled, preintegrate, start_from_positions
from heliograph.lie import ExtendedPose, se23, so3
from states import GRAVITY, NOISE, START_NS, random_imu

DOWN = np.array([0.0, 0.0, -GRAVITY])


def seen(rng, count=12):
    """Return an IMU, stamps, the state at the first of them, and true positions."""
    imu = random_imu(rng, duration=0.5 * count)
    stamps = START_NS + 500_000_000 * np.arange(count, dtype=np.int64)
    X = ExtendedPose(se23.exp(rng.normal(size=9) * np.array([1.0] * 3 + [10.0] * 6)))
    motion = preintegrate(imu, np.full(count, stamps[0]), stamps, noise=NOISE)
    return imu, stamps, X, motion.predict(X, np.zeros(3), np.zeros(3), DOWN).position


@pytest.mark.parametrize("seed", range(3))
def test_start_is_found_without_a_guess(seed):
    imu, stamps, X, p = seen(np.random.default_rng(seed))
    start = start_from_positions(imu, stamps, p, sigma=1.0, noise=NOISE)
    np.testing.assert_allclose(start.X_world_imu.matrix, X.matrix, rtol=0, atol=1e-6)
    assert start.rms_m < 1e-6


def test_covariance_of_the_start_is_that_of_drawn_positions(rng):
    imu, stamps, X, p = seen(rng)
    sigma, errors = 0.05, []
    for _ in range(300):
        start = start_from_positions(imu, stamps, p + sigma * rng.normal(size=p.shape), sigma=sigma, noise=NOISE)
        errors.append(so3.local(X.rotation, start.X_world_imu.rotation))
    squared = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(start.rotation_covariance), errors)
    assert 0.7 < squared.mean() / 3.0 < 1.3


def test_heading_is_unknown_in_straight_motion_at_constant_speed():
    stamps = START_NS + 10_000_000 * np.arange(1001, dtype=np.int64)
    rest = np.zeros((1001, 3))
    imu = ImuBatch(stamps_ns=stamps, gyro=rest, accel=rest - DOWN, received_ns=0)
    fixes = START_NS + 1_000_000_000 * np.arange(11, dtype=np.int64)
    p = 10.0 * np.arange(11)[:, None] * np.array([1.0, 0.0, 0.0])
    start = start_from_positions(imu, fixes, p, sigma=1.0, noise=NOISE)
    sigma = np.sqrt(np.diag(start.rotation_covariance))
    assert sigma[2] == pytest.approx(np.pi)
    assert sigma[:2].max() < 0.05


def test_what_cannot_start_is_refused(rng):
    imu, stamps, _, p = seen(rng)
    for some, positions in ((stamps[:3], p[:3]), (stamps, p[:-1]), (stamps, p[:, :2])):
        with pytest.raises(DataError, match="at least 4 positions"):
            start_from_positions(imu, some, positions, sigma=1.0, noise=NOISE)


def filled(imu, first, last):
    """Replace samples between two of them by a straight line."""
    gyro, accel = imu.gyro.copy(), imu.accel.copy()
    t = (imu.stamps_ns - imu.stamps_ns[0]).astype(np.float64)
    for channel in (gyro, accel):
        for column in channel.T:
            column[first:last] = np.interp(t[first:last], t[[first - 1, last]], column[[first - 1, last]])
    return replace(imu, gyro=gyro, accel=accel)


def test_filled_gaps_are_dropped_and_nothing_else(rng):
    imu = random_imu(rng, duration=3.0)
    imu = replace(imu, gyro=imu.gyro + 1e-3 * rng.normal(size=imu.gyro.shape))
    kept, gaps = drop_filled(imu)
    assert len(kept) == len(imu)
    assert len(gaps) == 0
    kept, gaps = drop_filled(filled(filled(imu, 50, 80), 200, 206))
    np.testing.assert_array_equal(gaps, imu.stamps_ns[[[49, 80], [199, 206]]])
    np.testing.assert_array_equal(kept.stamps_ns, np.delete(imu.stamps_ns, [*range(50, 80), *range(200, 206)]))
    assert len(drop_filled(filled(imu, 50, 54))[0]) == len(imu)  # a few may be chance


def test_an_imu_without_noise_keeps_all():
    stamps = START_NS + 10_000_000 * np.arange(100, dtype=np.int64)
    ones = np.ones((100, 3))
    imu = ImuBatch(stamps_ns=stamps, gyro=0.1 * ones, accel=GRAVITY * ones, received_ns=0)
    assert drop_filled(imu)[0] is imu
    with pytest.raises(DataError, match="at least one"):
        drop_filled(imu, least=0)
