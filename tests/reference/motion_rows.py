"""Slow, obvious twin of what the factors of preintegrated motions keep: rows, samples, and the linear range."""

import numpy as np

from heliograph.factors.motion_rows import LINEAR_SHARE
from heliograph.imu.propagation import model_numbers

FEWEST = 16  # rows of samples


def motion_rows(motion):
    """Return rows (N, 92): motion, times, biases, their derivatives, the linear range, and how it was integrated."""
    count = len(motion)
    first, last = _sample_range(motion)
    columns = (
        motion.delta_R,
        motion.delta_p,
        motion.delta_v,
        motion.duration_s,
        motion.gravity_s,
        motion.gravity_s2,
        motion.gyro_bias,
        motion.accel_bias,
        motion.bias_jacobian,
        linear_range(motion),
        last - first,
        motion.end_ns - motion.start_ns,
        np.broadcast_to(model_numbers(motion.noise, motion.config), (count, 10)),
    )
    return np.concatenate([np.asarray(column, dtype=np.float64).reshape(count, -1) for column in columns], axis=1)


def kept_samples(motion):
    """Return the samples (N, S, 7) that each interval was integrated from: stamp from its start [ns], rate, force.

    Unused rows are zero. Stamps within an interval are exact in doubles.
    """
    first, last = _sample_range(motion)
    most = int((last - first).max(initial=0))
    size = max(FEWEST, 1 << (most - 1).bit_length()) if len(motion) else FEWEST
    rows = first[:, None] + np.arange(size)
    used, rows = rows < last[:, None], np.minimum(rows, len(motion.imu) - 1)
    out = np.concatenate(
        [
            (motion.imu.stamps_ns[rows] - motion.start_ns[:, None])[..., None].astype(np.float64),
            motion.imu.gyro[rows],
            motion.imu.accel[rows],
        ],
        axis=2,
    )
    out[~used] = 0.0
    return out


def linear_range(motion):
    """Return (a, b) a motion, (N, 2): in the linear range ``a |dg|^2 + b |dg| |da| < 1``, (dg, da) the biases' change.

    Bounds of the second order of the motion by the biases, over time T under a specific force A: the rotation's is
    |dg|^2 T^2 / 2, the velocity's A |dg|^2 T^3 / 6 + |dg| |da| T^2 / 2, the position's that integrated once more. They
    are measured by the motion's own standard deviations, and may reach `LINEAR_SHARE` of them.
    """
    sigma = np.sqrt(np.einsum("nii->ni", motion.covariance)).reshape(-1, 3, 3).min(axis=2)
    turn, position, velocity = np.maximum(LINEAR_SHARE * sigma, 1e-300).T
    T, force = motion.duration_s, _mean_force(motion)
    by_gyro = np.stack([T**2 / 2.0 / turn, force * T**3 / 6.0 / velocity, force * T**4 / 24.0 / position])
    by_both = np.stack([T**2 / 2.0 / velocity, T**3 / 6.0 / position])
    return np.asarray(np.minimum(np.stack([by_gyro.max(axis=0), by_both.max(axis=0)], axis=1), 1e300))


def _mean_force(motion):
    """Return the mean length of the specific force over each interval, (N,) [m/s^2]."""
    first, last = _sample_range(motion)
    if not len(first):
        return np.zeros(0)
    begin = int(first.min())  # one interval of a long recording does not pay for all of it
    total = np.concatenate([[0.0], np.cumsum(np.linalg.norm(motion.imu.accel[begin : last.max()], axis=1))])
    return np.asarray((total[last - begin] - total[first - begin]) / (last - first))


def _sample_range(motion):
    """Return the first and one past the last sample that matter to each interval: one before it to one after it."""
    stamps = motion.imu.stamps_ns
    first = np.maximum(np.searchsorted(stamps, motion.start_ns, side="right") - 1, 0)
    last = np.minimum(np.searchsorted(stamps, motion.end_ns, side="left"), len(stamps) - 1) + 1
    return first, np.maximum(last, first + 1)
