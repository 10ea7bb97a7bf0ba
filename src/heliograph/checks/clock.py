"""The IMU's clock against the recorder's: steps and drift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.checks.records import ImuRecord

__all__ = ["CLOCK_STEP", "clock_drift", "clock_steps"]


CLOCK_STEP = 0.02
"""A step of the header stamps against the times of reception that is not transport any more [s]."""
_MIN_SAMPLES = 10  # samples below which nothing can be said
_BLOCK_S = 1.0  # over which the quickest delivery stands for the clock [s]


def clock_steps(imu: ImuRecord) -> tuple[NDArray[np.int64], Array]:
    """Return the samples at which the header stamps step against the times of reception, and by how much [s].

    A step of the clock is there in every later second, and it is the stamps that are oddly spaced there, not the times
    of reception: messages held up in a queue show the opposite.
    """
    if len(imu) < _MIN_SAMPLES or imu.received_ns[-1] <= imu.received_ns[0]:
        return np.zeros(0, np.int64), np.zeros(0)
    lag = (imu.received_ns - imu.stamps_ns) * 1e-9
    lag = lag - lag[0]
    at = (imu.received_ns - imu.received_ns[0]) * 1e-9
    width = min(_BLOCK_S, at[-1] / 6.0)
    block = np.unique(np.minimum((at / width).astype(np.int64), int(at[-1] / width)), return_inverse=True)[1]
    quickest = _block_minima(block, lag)
    steps = np.diff(imu.stamps_ns) * 1e-9
    period = float(np.median(np.abs(steps)))
    limit = max(CLOCK_STEP, 2.0 * period)
    found: set[int] = set()
    for j in range(1, len(quickest) - 2):
        before, after = quickest[max(0, j - 2) : j + 1], quickest[j + 1 : j + 4]
        change = float(np.median(after) - np.median(before))
        apart = after.min() > before.max() if change > 0.0 else after.max() < before.min()
        if apart and abs(change) > limit:
            near = np.flatnonzero((block >= j) & (block <= j + 1))[1:]
            jump = int(near[np.abs(np.diff(lag)[near - 1]).argmax()])
            if abs(steps[jump - 1] - period) > 0.5 * limit < abs(lag[jump] - lag[jump - 1]):
                found.add(jump)
    jumps = np.array(sorted(found), dtype=np.int64)
    return jumps, np.asarray(lag[jumps - 1] - lag[jumps])


def _block_minima(block: NDArray[np.int64], values: Array) -> Array:
    """Return the smallest value of each block; blocks are numbered from 0 without a gap."""
    lowest = np.full(int(block.max()) + 1, np.inf)
    np.minimum.at(lowest, block, values)
    return lowest


def clock_drift(imu: ImuRecord) -> tuple[float, float, float]:
    """Return how fast the stamps run against the times of reception, its sigma [ppm], and the time looked at [s]."""
    lag = (imu.received_ns - imu.stamps_ns) * 1e-9
    at = (imu.received_ns - imu.received_ns[0]) * 1e-9
    if at[-1] <= 0.0:
        return 0.0, 0.0, 0.0
    block = np.unique((at / max(_BLOCK_S, at[-1] / 300.0)).astype(np.int64), return_inverse=True)[1]
    lowest = _block_minima(block, lag - lag[0])
    times = _block_minima(block, at)
    if len(lowest) < 3:
        return 0.0, 0.0, float(at[-1])
    i, j = np.triu_indices(len(lowest), 1)
    slope = float(np.median((lowest[j] - lowest[i]) / (times[j] - times[i])))
    rest = lowest - slope * times
    spread = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    sigma = spread / (float(np.std(times)) * np.sqrt(len(times)))
    return 0.0 - 1e6 * slope, 1e6 * sigma, float(at[-1])
