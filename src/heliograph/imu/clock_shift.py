"""How a prediction changes where the clocks of LiDAR and IMU differ by a little more."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.data import ImuBatch, ImuNoise, NavState
from heliograph.data.error_layout import NAV_DIM, POSITION, ROTATION, VELOCITY

__all__ = ["HALF_WINDOW", "clock_shift"]


HALF_WINDOW = 0.015
"""The signals at an instant are means from this long before to this long after it: single samples are noise [s]."""
_CLEAR_SIGMAS = 3.0  # sigmas of that noise beyond which a change is taken to be one


def clock_shift(before: NavState, after: NavState, imu: ImuBatch, transition: Array, noise: ImuNoise) -> Array:
    """Return the derivative of a predicted state's errors by the offset of the IMU's clock at its start, (17,).

    With a larger offset the interval [s, e] lies later in the samples. The state that it leads to is the same one
    carried on past e and begun after s, so with f = (rate, velocity, acceleration, 0 ...), the speed of the errors,

        d x(e) / d offset = f(e) - F f(s)

    exactly (eq. 11 of docs/theory/filter.md). A steady motion leaves nothing of it. What is left at rest is the noise
    of the samples, which would pass for knowledge in a filter: parts no larger than it are left out.

    Parameters
    ----------
    before, after : NavState
        At both ends of the interval.
    imu : ImuBatch
        Samples around the interval, in the clock of the states' stamps.
    transition : (17, 17) float64
        F of this interval.
    noise : ImuNoise
    """
    start, end = _speed(before, imu), _speed(after, imu)
    shift = end - transition @ start
    span = (after.stamp_ns - before.stamp_ns) * 1e-9
    variance = 3.0 * noise.gyro**2 / HALF_WINDOW  # of the difference of two means over three axes
    force = float(np.linalg.norm(after.g_odom)) + float(np.linalg.norm(end[VELOCITY]))
    variance_force = 3.0 * noise.accel**2 / HALF_WINDOW + (force * span) ** 2 * variance
    if float(shift[ROTATION] @ shift[ROTATION]) < _CLEAR_SIGMAS**2 * variance:
        shift[ROTATION] = 0.0
    if float(shift[VELOCITY] @ shift[VELOCITY]) < _CLEAR_SIGMAS**2 * variance_force:
        shift[POSITION] = shift[VELOCITY] = 0.0
    return np.asarray(shift)


def _speed(state: NavState, imu: ImuBatch) -> Array:
    """Return how fast the errors' coordinates move, (17,): rotation about body axes, position and velocity in odom."""
    away = np.abs(imu.stamps_ns - state.stamp_ns)
    near = away <= max(int(HALF_WINDOW * 1e9), int(away.min()))
    f = np.zeros(NAV_DIM)
    f[ROTATION] = imu.gyro[near].mean(axis=0) - state.gyro_bias
    f[POSITION] = state.v_odom
    f[VELOCITY] = state.R_odom_imu @ (imu.accel[near].mean(axis=0) - state.accel_bias) + state.g_odom
    return f
