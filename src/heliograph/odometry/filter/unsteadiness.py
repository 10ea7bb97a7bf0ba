"""How unsteadily a body moves, as a filter without an IMU sees it: what its constant velocity is corrected by.

Velocity and rate are taken to change by white noise. How much of it there is tells how far a prediction may be off, and
also how well a sweep tells the pose at its end: within a sweep the model knows one velocity and one rate, and what they
change by meanwhile bends the cloud. All matches of a scan share that error, so it does not average out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data import ImuNoise, NavState
from heliograph.data.error_layout import POSITION, ROTATION

__all__ = ["Unsteadiness"]


_GAIN = 0.1  # weight of the latest scan in the running mean
# A line fitted to uniform samples of an integrated random walk of density q over a time T misses its end by
# q^2 T^3 int_0^1 (u^2 - u^3)^2 du.
_BEND = 1.0 / 105.0


@dataclass(frozen=True, slots=True)
class Unsteadiness:
    """Densities of the changes of velocity and rate, as the corrections of past scans show them.

    Parameters
    ----------
    accel : float
        [m/s^2/sqrt(Hz)].
    gyro : float
        [rad/s^2/sqrt(Hz)].
    """

    accel: float = 0.0
    gyro: float = 0.0

    def __post_init__(self) -> None:
        freeze(self)

    def updated(self, prior: NavState, posterior: NavState, seconds: float) -> Unsteadiness:
        """Return the densities after one more scan, ``seconds`` after the one before it."""
        accel = _density(posterior.v_odom - prior.v_odom, seconds)
        gyro = _density(posterior.gyro_bias - prior.gyro_bias, seconds)
        return Unsteadiness(accel=_running(self.accel, accel), gyro=_running(self.gyro, gyro))

    def allowed(self, least: ImuNoise) -> ImuNoise:
        """Return the noise of the imaginary IMU: at least ``least``, and what has been seen."""
        return replace(least, accel=max(least.accel, self.accel), gyro_walk=max(least.gyro_walk, self.gyro))

    def bent(self, state: NavState, sweep: float) -> NavState:
        """Return the state at the end of a ``sweep`` [s] with the uncertainty that bending leaves in its pose."""
        covariance = state.covariance.copy()
        covariance[ROTATION, ROTATION] += _BEND * self.gyro**2 * sweep**3 * np.eye(3)
        covariance[POSITION, POSITION] += _BEND * self.accel**2 * sweep**3 * np.eye(3)
        return replace(state, covariance=covariance)


def _density(change: Array, seconds: float) -> float:
    return float(np.sqrt(change @ change / (3.0 * seconds))) if seconds > 0.0 else 0.0


def _running(mean: float, latest: float) -> float:
    # What is larger than all before it counts at once: motion sets in suddenly.
    return max(float(np.sqrt((1.0 - _GAIN) * mean**2 + _GAIN * latest**2)), latest)
