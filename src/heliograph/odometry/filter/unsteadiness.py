"""How unsteadily a body moves, as a filter without an IMU sees it: what its constant velocity is corrected by.

Velocity and rate are taken to change by white noise. How much of it there is tells how far a prediction may be off.
Within a sweep the model knows one velocity and one rate, and what they change by meanwhile bends the cloud. All matches
of a scan share that error, so it does not average out; and what changes several times within a sweep hardly shows in
the corrections from one to the next, so it is measured in the sweeps themselves (`sweep_bend`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data import ImuNoise, NavState
from heliograph.data.error_layout import POSITION, ROTATION
from heliograph.odometry.filter.bending import SweepBend

__all__ = ["Unsteadiness"]


_GAIN = 0.1  # weight of the latest scan in the running mean
_BEND = 1.0 / 105.0  # the integral of `Unsteadiness.smoothly_bent`
_BOTH = 2.0  # the planes were laid by scans that are bent as this one is


@dataclass(frozen=True, slots=True)
class Unsteadiness:
    """Densities of the changes of velocity and rate, as the corrections of past scans show them, and how bent they are.

    Parameters
    ----------
    accel : float
        [m/s^2/sqrt(Hz)].
    gyro : float
        [rad/s^2/sqrt(Hz)].
    turn, move : float
        What poses at sweeps' ends miss by, an axis [rad], [m].
    """

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    move: float = 0.0

    def __post_init__(self) -> None:
        freeze(self)

    def updated(self, prior: NavState, posterior: NavState, seconds: float, bend: SweepBend | None) -> Unsteadiness:
        """Return what is known after one more scan, ``seconds`` after the one before it and bent by ``bend``."""
        accel = _density(posterior.v_odom - prior.v_odom, seconds)
        gyro = _density(posterior.gyro_bias - prior.gyro_bias, seconds)
        turn, move = (bend.turn, bend.move) if bend is not None else (0.0, 0.0)
        return Unsteadiness(
            accel=_running(self.accel, accel),
            gyro=_running(self.gyro, gyro),
            turn=_running(self.turn, turn),
            move=_running(self.move, move),
        )

    def allowed(self, least: ImuNoise) -> ImuNoise:
        """Return the noise of the imaginary IMU: at least ``least``, and what has been seen."""
        return replace(least, accel=max(least.accel, self.accel), gyro_walk=max(least.gyro_walk, self.gyro))

    def smoothly_bent(self, state: NavState, sweep: float) -> NavState:
        """Return the state at the end of a ``sweep`` [s] with what white changes leave where nothing measures them.

        A line fitted to uniform samples of an integrated random walk of density q over a time T misses its end by
        ``q^2 T^3 int_0^1 (u^2 - u^3)^2 du``.
        """
        covariance = state.covariance.copy()
        covariance[ROTATION, ROTATION] += _BEND * self.gyro**2 * sweep**3 * np.eye(3)
        covariance[POSITION, POSITION] += _BEND * self.accel**2 * sweep**3 * np.eye(3)
        return replace(state, covariance=covariance)

    def bent(self, state: NavState, share: float = 1.0) -> NavState:
        """Return the state at a sweep's end with a share of the variance that bending leaves in its pose."""
        covariance = state.covariance.copy()
        covariance[ROTATION, ROTATION] += share * _BOTH * self.turn**2 * np.eye(3)
        covariance[POSITION, POSITION] += share * _BOTH * self.move**2 * np.eye(3)
        return replace(state, covariance=covariance)


def _density(change: Array, seconds: float) -> float:
    return float(np.sqrt(change @ change / (3.0 * seconds))) if seconds > 0.0 else 0.0


def _running(mean: float, latest: float) -> float:
    # What is larger than all before it counts at once: motion sets in suddenly.
    return max(float(np.sqrt((1.0 - _GAIN) * mean**2 + _GAIN * latest**2)), latest)
