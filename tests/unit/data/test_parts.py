"""Parts of inertial batches and scans, batches put together, and what counts as a matched scan."""

import numpy as np
import pytest

from heliograph.data import ImuBatch, Scan
from states import START_NS, random_imu


def test_part_of_a_batch_keeps_its_samples_together(rng):
    whole = random_imu(rng)
    mask = np.arange(len(whole)) % 3 == 1
    for part in (slice(2, 7), slice(None, None, 2), mask, np.flatnonzero(mask)):
        some = whole[part]
        for name in ("stamps_ns", "gyro", "accel"):
            np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[part])
        assert (some.received_ns, some.frame_id) == (whole.received_ns, whole.frame_id)
    assert len(whole[5:5]) == 0


def test_joined_batches_are_the_whole(rng):
    whole = random_imu(rng)
    again = ImuBatch.joined([whole[:4], whole[4:4], whole[4:]])
    for name in ("stamps_ns", "gyro", "accel"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    assert again.received_ns == whole.received_ns
    nothing = ImuBatch.joined([])
    assert len(nothing) == 0
    assert nothing.gyro.shape == nothing.accel.shape == (0, 3)


@pytest.mark.parametrize("step", [1, 3, 100])
def test_thinned_scan_keeps_times_and_every_nth_point(rng, step):
    points = rng.normal(size=(20, 3)).astype(np.float32)
    offsets = np.arange(20, dtype=np.int32)
    scan = Scan(
        stamp_ns=START_NS, header_stamp_ns=START_NS, received_ns=START_NS, end_ns=START_NS + 19, points=points,
        offsets_ns=offsets, intensity=np.ones(20, np.float32), ring=np.zeros(20, np.uint16),
    )  # fmt: skip
    thin = scan.thinned(step)
    np.testing.assert_array_equal(thin.points, points[::step])
    np.testing.assert_array_equal(thin.offsets_ns, offsets[::step])
    assert (thin.stamp_ns, thin.end_ns) == (scan.stamp_ns, scan.end_ns)
    assert thin.intensity is None
    assert thin.ring is None
