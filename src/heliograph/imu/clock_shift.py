"""How a prediction changes where the clocks of LiDAR and IMU differ by a little more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.data import ImuBatch, ImuNoise, NavState

__all__ = ["AROUND", "clock_shift"]

Array = NDArray[np.float64]

AROUND = 0.015
"""The signals at an instant are means over so much before and after it: single samples are mostly noise [s]."""
_CLEAR = 3.0  # sigmas of that noise beyond which a change is taken to be one


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
    variance = 3.0 * noise.gyro**2 / AROUND  # of the difference of two means over three axes
    force = float(np.linalg.norm(after.g_odom)) + float(np.linalg.norm(end[6:9]))
    variance_force = 3.0 * noise.accel**2 / AROUND + (force * span) ** 2 * variance
    if float(shift[0:3] @ shift[0:3]) < _CLEAR**2 * variance:
        shift[0:3] = 0.0
    if float(shift[6:9] @ shift[6:9]) < _CLEAR**2 * variance_force:
        shift[3:9] = 0.0
    return np.asarray(shift)


def _speed(state: NavState, imu: ImuBatch) -> Array:
    """Return how fast the errors' coordinates move, (17,): rotation about body axes, position and velocity in odom."""
    away = np.abs(imu.stamps_ns - state.stamp_ns)
    near = away <= max(int(AROUND * 1e9), int(away.min()))
    f = np.zeros(17)
    f[0:3] = imu.gyro[near].mean(axis=0) - state.gyro_bias
    f[3:6] = state.v_odom
    f[6:9] = state.R_odom_imu @ (imu.accel[near].mean(axis=0) - state.accel_bias) + state.g_odom
    return f
