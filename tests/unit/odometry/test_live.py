"""A live driver gives samples one by one, a file in batches: both come to the same packets and the same start."""

import numpy as np

from fakes import IMU_STEP_NS, make_batch
from heliograph.odometry.sequencer import ImuBuffer


def test_samples_until_an_instant_end_with_the_first_at_or_after_it():
    buffer, batch = ImuBuffer(), make_batch(0)
    buffer.append(batch)
    stamps = batch.stamps_ns
    for end, last in ((stamps[3], 3), (stamps[3] + 1, 4), (stamps[-1] + IMU_STEP_NS, len(stamps) - 1)):
        np.testing.assert_array_equal(buffer.until(int(end)).stamps_ns, stamps[: last + 1])
