"""Even stretches out of jittered, broken and restless records."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu.stretches import even_stretches, still_stretches
from imu_noise import START_NS, resting_imu

CONFIG = ImuConfig()
RATE = 200.0


def taken(imu, keep):
    return replace(imu, stamps_ns=imu.stamps_ns[keep], gyro=imu.gyro[keep], accel=imu.accel[keep])


def spans(grid):
    """Begin and end of each stretch since the start [s]."""
    return [
        (1e-9 * (s.begin_ns - START_NS), 1e-9 * (s.begin_ns - START_NS) + grid.period * len(s)) for s in grid.stretches
    ]


def test_even_record_is_one_stretch_as_it_is(rng):
    imu = resting_imu(rng, duration=3.0, rate=RATE)
    grid = even_stretches(imu)
    assert (len(grid.stretches), grid.filled, grid.gaps) == (1, 0, 0)
    assert grid.period == pytest.approx(1.0 / RATE)
    np.testing.assert_array_equal(grid.stretches[0].samples, np.hstack([imu.gyro, imu.accel]))


def test_single_losses_are_interpolated_and_long_ones_split(rng):
    imu = resting_imu(rng, duration=20.0, rate=RATE)
    keep = np.ones(len(imu.stamps_ns), dtype=bool)
    keep[[700, 1000, 1001]] = False
    keep[2000:2040] = False
    grid = even_stretches(taken(imu, keep))
    assert (grid.filled, grid.gaps) == (3, 1)
    assert [len(s) for s in grid.stretches] == [2000, 4000 - 2040]
    np.testing.assert_allclose(
        grid.stretches[0].samples[700, :3], 0.5 * (imu.gyro[699] + imu.gyro[701]), rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize("kind", ["noise", "batches"])
def test_jittered_stamps_lose_no_sample_and_make_none_up(rng, kind):
    imu = resting_imu(rng, duration=60.0, rate=RATE)
    index = np.arange(len(imu))
    if kind == "noise":  # up to 0.6 of a step early or late
        late = 0.6 / RATE * rng.uniform(-1.0, 1.0, len(imu))
        stamps = np.sort(imu.stamps_ns + np.rint(1e9 * late).astype(np.int64))
        stamps += np.arange(len(stamps))  # sorted stamps may coincide
    else:  # eight come at once, stamped as they arrive
        stamps = imu.stamps_ns[np.minimum(index // 8 * 8 + 7, len(imu) - 1)] + 10_000 * (index % 8)
    grid = even_stretches(replace(imu, stamps_ns=stamps))
    assert grid.period == pytest.approx(1.0 / RATE, rel=1e-4)
    assert sum(len(s) for s in grid.stretches) == pytest.approx(len(imu), abs=12)
    assert grid.gaps <= 1


@pytest.mark.parametrize("seconds", [3.0, 1e6, 3e8])
@pytest.mark.parametrize("at", [1, 600, 1199])
def test_a_pause_of_any_length_leaves_the_period(rng, seconds, at):
    imu = resting_imu(rng, duration=1201 / RATE, rate=RATE)
    stamps = imu.stamps_ns + np.where(np.arange(1201) >= at, round(1e9 * seconds), 0)
    grid = even_stretches(replace(imu, stamps_ns=stamps))
    assert grid.period == pytest.approx(0.005, rel=1e-6)
    assert grid.gaps == 1 and [len(stretch) for stretch in grid.stretches] == [at, 1201 - at]


def test_reversed_and_repeated_stamps_are_refused(rng):
    imu = resting_imu(rng, duration=1.0, rate=RATE)
    with pytest.raises(DataError, match="199 of 200 IMU stamps do not increase"):
        even_stretches(replace(imu, stamps_ns=imu.stamps_ns[::-1]))
    with pytest.raises(DataError, match="1 IMU samples"):
        even_stretches(taken(imu, [0]))


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(2, 400), loss=st.floats(0.0, 0.6), period_ns=st.integers(1_000_000, 100_000_000), seed=st.integers(0)
)
def test_any_losses_keep_order_and_samples(n, loss, period_ns, seed):
    rng = np.random.default_rng(seed)
    keep = rng.uniform(size=n) >= loss
    keep[[0, -1]] = True
    stamps = START_NS + period_ns * np.flatnonzero(keep)
    samples = rng.normal(size=(len(stamps), 3))
    grid = even_stretches(ImuBatch(stamps_ns=stamps, gyro=samples, accel=samples, received_ns=0))
    assert sum(len(s) for s in grid.stretches) == len(stamps) + grid.filled
    assert len(grid.stretches) == grid.gaps + 1
    begins = [s.begin_ns for s in grid.stretches]
    assert begins == sorted(begins)
    assert all(np.isfinite(s.samples).all() for s in grid.stretches)


def test_rest_is_kept_whole(rng):
    still = still_stretches(even_stretches(resting_imu(rng, duration=30.0, rate=RATE)), CONFIG)
    assert spans(still) == [(0.0, pytest.approx(30.0))]


def test_rest_of_a_noisy_imu_at_a_high_rate_is_kept(rng):
    """Its samples spread by 0.06 rad/s and 0.6 m/s^2, twice the limits for motion."""
    imu = resting_imu(rng, duration=12.0, rate=1000.0, gyro={"white": 2e-3}, accel={"white": 2e-2})
    assert spans(still_stretches(even_stretches(imu), CONFIG)) == [(0.0, pytest.approx(12.0))]


def test_motion_inside_is_cut_out_with_a_margin(rng):
    imu = resting_imu(rng, duration=60.0, rate=RATE)
    t = 1e-9 * (imu.stamps_ns - START_NS)
    bump = np.where((t > 20.2) & (t < 24.7), 0.02 * np.sin(9.0 * (t - 20.2)), 0.0)
    (first, last), (begin, end) = spans(
        still_stretches(even_stretches(replace(imu, gyro=imu.gyro + bump[:, None])), CONFIG)
    )
    assert (first, end) == (0.0, pytest.approx(60.0))
    assert 18.0 < last <= 20.2
    assert 24.7 <= begin < 27.0


def test_slow_turn_splits_the_rest(rng):
    """0.05 rad/s passes every limit; only the step of the mean gives it away."""
    imu = resting_imu(rng, duration=60.0, rate=RATE)
    t = 1e-9 * (imu.stamps_ns - START_NS)
    turning = np.where((t > 30.0) & (t < 33.0), 0.05, 0.0)[:, None] * [0.0, 0.0, 1.0]
    found = spans(still_stretches(even_stretches(replace(imu, gyro=imu.gyro + turning)), CONFIG))
    assert all(end <= 30.0 or begin >= 33.0 for begin, end in found)
    assert len(found) == 2


@pytest.mark.parametrize(
    "shake",
    [
        lambda t: 0.5 * np.sin(2.0 * np.pi * 3.0 * t),  # driven
        lambda t: 0.01 * np.sin(2.0 * np.pi * 0.7 * t),  # held in a hand
    ],
)
def test_nothing_still_gives_nothing(rng, shake):
    imu = resting_imu(rng, duration=30.0, rate=RATE)
    t = 1e-9 * (imu.stamps_ns - START_NS)
    moved = replace(imu, gyro=imu.gyro + shake(t)[:, None])
    assert still_stretches(even_stretches(moved), CONFIG).stretches == ()


def test_coarse_and_constant_channels_are_still(rng):
    imu = resting_imu(rng, duration=20.0, rate=RATE)
    coarse = replace(imu, gyro=np.round(imu.gyro / 0.01) * 0.01, accel=np.tile([0.0, 0.0, 9.8], (len(imu), 1)))
    assert spans(still_stretches(even_stretches(coarse), CONFIG)) == [(0.0, pytest.approx(20.0))]


def test_short_record_has_no_rest(rng):
    for duration in (0.02, 3.0):
        assert still_stretches(even_stretches(resting_imu(rng, duration=duration, rate=RATE)), CONFIG).stretches == ()
