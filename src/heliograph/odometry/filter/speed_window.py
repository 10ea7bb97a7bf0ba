"""What wheels or legs say of the motion just before a scan's end: one mean speed, and what a state says of it.

A speed's error lasts about as long as a sweep, so the speeds of a sweep count as one: their mean, turned with the body
into the imu axes of its end. A state at the end foresees it by

    ``h = R^T (v - g T / 2) - k + (b_a - b_a0) T / 2 + l x (b_g - b_g0) + w``,

with k what the specific force has changed the velocity by since the window's middle, w the mean velocity of the point
against the imu, both in axes of the end, and b_a0, b_g0 the biases that they were integrated with; eq. (17) of
docs/theory/filter.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, Stamps, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import ACCEL_BIAS, GRAVITY, GYRO_BIAS, ROTATION, VELOCITY, WHEEL_SCALE
from heliograph.imu import ImuPath
from heliograph.lie import s2, so3

__all__ = ["SpeedWindow"]

_WINDOW_NS = 250_000_000  # before the end, beyond which the force's change is no line any more
_LONGEST_NS = 300_000_000  # between two speeds; across a longer gap nothing is said


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedWindow:
    """The mean speed of a point of the body over a short time up to a state.

    Parameters
    ----------
    seconds : float
        Length of the window [s].
    measured : (3,) float64
        Mean of the measured speeds, imu axes at the end [m/s].
    changed : (3,) float64
        What the specific force has changed the mean velocity by up to the end, imu axes there [m/s].
    swung : (3,) float64
        Mean velocity of the point against the imu, imu axes at the end [m/s].
    arm : (3,) float64
        The point in the imu frame [m].
    R_imu_vehicle : (3, 3) float64
        Axes of the vehicle.
    gyro_bias, accel_bias : (3,) float64
        Biases that the motion was integrated with.
    """

    seconds: float
    measured: Array
    changed: Array
    swung: Array
    arm: Array
    R_imu_vehicle: Array
    gyro_bias: Array
    accel_bias: Array

    def __post_init__(self) -> None:
        freeze(self)

    @classmethod
    def of(
        cls, stamps_ns: Stamps, v_imu: Array, path: ImuPath, state: NavState, R_imu_vehicle: Array, arm: Array
    ) -> SpeedWindow | None:
        """Return the window that ends with a predicted path; None where the speeds do not cover it.

        Parameters
        ----------
        stamps_ns : (N,) int64
            Times of all speeds, increasing [ns].
        v_imu : (N, 3) float64
            Speeds of the point in imu axes; 0 in what is not measured [m/s].
        path : ImuPath
            Predicted; it ends in ``state``.
        state : NavState
        R_imu_vehicle : (3, 3) float64
        arm : (3,) float64
            The point in the imu frame [m].
        """
        end_ns = int(path.stamps_ns[-1])
        begin = int(np.searchsorted(path.stamps_ns, max(end_ns - _WINDOW_NS, int(path.stamps_ns[0]))))
        times = path.stamps_ns[begin:]
        if len(times) < 2 or not _covered(stamps_ns, int(times[0]), end_ns):
            return None
        near = slice(int(np.searchsorted(stamps_ns, times[0], side="right")) - 1,
                     int(np.searchsorted(stamps_ns, end_ns)) + 1)  # fmt: skip
        speed = np.stack([np.interp(times, stamps_ns[near], column) for column in v_imu[near].T], axis=-1)
        R_end = path.R_odom_imu[-1]
        R_end_imu = R_end.T @ path.R_odom_imu[begin:]
        seconds = 1e-9 * float(times[-1] - times[0])
        mean = (path.p_odom[-1] - path.p_odom[begin]) / seconds
        return cls(
            seconds=seconds,
            measured=_mean(1e-9 * (times - times[0]), np.einsum("nij,nj->ni", R_end_imu, speed)),
            changed=R_end.T @ (path.v_odom[-1] - 0.5 * seconds * state.g_odom - mean),
            swung=(np.eye(3) - R_end_imu[0]) @ arm / seconds,
            arm=arm,
            R_imu_vehicle=R_imu_vehicle,
            gyro_bias=state.gyro_bias,
            accel_bias=state.accel_bias,
        )

    def foreseen(self, state: NavState) -> Array:
        """Return the mean velocity (3,) of the point as a state at the end has it, vehicle axes [m/s]."""
        half = 0.5 * self.seconds
        velocity = state.R_odom_imu.T @ (state.v_odom - half * state.g_odom) - self.changed
        velocity = velocity + half * (state.accel_bias - self.accel_bias) + self.swung
        return np.asarray(self.R_imu_vehicle.T @ (velocity + np.cross(self.arm, state.gyro_bias - self.gyro_bias)))

    def residual(self, state: NavState) -> Array:
        """Return the measured speed, scaled, less the foreseen one, (3,) vehicle axes [m/s]."""
        return np.asarray(state.wheel_scale * (self.R_imu_vehicle.T @ self.measured) - self.foreseen(state))

    def jacobian(self, state: NavState) -> Array:
        """Return the derivative (3, K) of the residual by the errors of a state, which has one of the scale."""
        half, R_odom_imu = 0.5 * self.seconds, state.R_odom_imu
        J = np.zeros((3, len(state.covariance)))
        J[:, ROTATION] = -so3.hat(R_odom_imu.T @ (state.v_odom - half * state.g_odom))
        J[:, VELOCITY] = -R_odom_imu.T
        J[:, ACCEL_BIAS] = -half * np.eye(3)
        J[:, GYRO_BIAS] = -so3.hat(self.arm)
        size = float(np.linalg.norm(state.g_odom))
        if size > 0.0:
            J[:, GRAVITY] = half * size * R_odom_imu.T @ s2.retract_jacobian(state.g_odom / size, np.zeros(2))
        J[:, WHEEL_SCALE] = self.measured
        return np.asarray(self.R_imu_vehicle.T @ J)


def _covered(stamps_ns: Stamps, begin_ns: int, end_ns: int) -> bool:
    """Whether speeds reach from before a time to after another one without a long gap."""
    first = int(np.searchsorted(stamps_ns, begin_ns, side="right")) - 1
    last = int(np.searchsorted(stamps_ns, end_ns, side="left"))
    if first < 0 or last >= len(stamps_ns):
        return False
    return int(np.diff(stamps_ns[first : last + 1]).max(initial=0)) <= _LONGEST_NS


def _mean(seconds: Array, values: Array) -> Array:
    """Return the mean over time of values (N, 3), which are lines between their times."""
    steps = np.diff(seconds)[:, None]
    return np.asarray((0.5 * steps * (values[1:] + values[:-1])).sum(axis=0) / seconds[-1])
