"""One clock against another: there and back, by the formula, and one correction after another."""

import numpy as np
import pytest

from heliograph.data import ImuClock

REFERENCE = 1_750_000_000_123_456_789
CLOCK = ImuClock(offset=0.0213, drift=47e-6, reference_ns=REFERENCE)
STAMPS = REFERENCE + np.array([-3_600_000_000_000, -1, 0, 1, 20_000_000_000, 3_600_000_000_000])


def test_clock_shows_what_its_formula_says():
    seconds = (STAMPS - REFERENCE).astype(np.float64) * 1e-9
    late = (CLOCK.imu_time(STAMPS) - STAMPS).astype(np.float64) * 1e-9
    np.testing.assert_allclose(late, 0.0213 + 47e-6 * seconds, rtol=0, atol=1e-9)
    assert CLOCK.imu_time(np.int64(REFERENCE)) == REFERENCE + 21_300_000


@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6, 1e-2])
@pytest.mark.parametrize("offset", [0.0, 0.03, -12.5])
def test_clock_there_and_back_is_where_it_began(offset, drift):
    clock = ImuClock(offset=offset, drift=drift, reference_ns=REFERENCE)
    assert np.abs(clock.lidar_time(clock.imu_time(STAMPS)) - STAMPS).max() <= 1
    assert clock.exact == (offset == 0.0 and drift == 0.0)


def test_clock_of_increasing_stamps_is_increasing():
    dense = REFERENCE + np.arange(0, 1000, dtype=np.int64) * 1000
    assert np.diff(CLOCK.lidar_time(dense)).min() > 0


def test_clock_found_after_another_was_applied_is_both():
    applied = ImuClock(offset=-0.5, drift=-20e-6, reference_ns=REFERENCE - 7_000_000_000)
    both = CLOCK.after(applied)
    assert np.abs(both.imu_time(STAMPS) - applied.imu_time(CLOCK.imu_time(STAMPS))).max() <= 3
