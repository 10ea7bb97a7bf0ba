"""Preintegrated motions as the numbers that their factors keep and the native kernels read."""

from __future__ import annotations

import numpy as np

from heliograph import _core
from heliograph.arrays import Array
from heliograph.imu import Preintegration
from heliograph.imu.propagation import model_numbers

__all__ = ["LINEAR_SHARE", "MOTION_NUMBERS", "motion_measurements"]


LINEAR_SHARE = 0.02
"""Share of a standard deviation that the first-order correction of the biases may be off before it is given up."""

MOTION_NUMBERS = 92
"""Numbers of a motion, before those of gravity and of the samples."""


def motion_measurements(motion: Preintegration, gravity: Array, keep_samples: bool) -> tuple[Array, bool]:
    """Return the measurements (N, m) of the motions' factors, and whether all numbers are finite.

    Each row holds the motion, times, biases, their derivatives, the linear range and how it was integrated
    (`MOTION_NUMBERS`); then what is known of gravity; then the samples that it was integrated from, each a stamp from
    the interval's start [ns], a rate and a force. Rows of samples are a power of two, so that factors of alike
    intervals are one group; unused ones are zero.

    Parameters
    ----------
    motion : Preintegration
        Preintegrated motion of N intervals.
    gravity : (3,) or (1,) float64
        In the world [m/s^2], or its magnitude.
    keep_samples : bool
        Keep the samples.
    """
    flat = np.ascontiguousarray
    measurement, finite = _core.motion_measurements(
        motion.imu.stamps_ns,
        motion.imu.gyro,
        motion.imu.accel,
        flat(motion.start_ns),
        flat(motion.end_ns),
        flat(motion.delta_R),
        flat(motion.delta_p),
        flat(motion.delta_v),
        flat(motion.duration_s),
        flat(motion.gravity_s),
        flat(motion.gravity_s2),
        flat(motion.gyro_bias),
        flat(motion.accel_bias),
        flat(motion.bias_jacobian),
        flat(motion.covariance),
        model_numbers(motion.noise, motion.config),
        gravity,
        LINEAR_SHARE,
        keep_samples,
    )
    return measurement, finite
