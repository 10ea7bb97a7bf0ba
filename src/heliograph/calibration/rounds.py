"""Rounds of solving and placing, each from where the last one ended, until nothing that matters changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array
from heliograph.calibration.batch import Estimate, estimate, guess_motion
from heliograph.calibration.observability import Observed, analyse, difference, prior_sigmas
from heliograph.calibration.states import CalibrationState, LidarPoses, RigPrior
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, ImuNoise

__all__ = ["CalibrationRounds", "change_from", "run_rounds"]


_HOLD_FACTOR = 1e4  # how many times the prior's information holds a direction that is kept, while solving
_CHANGE_TOLERANCE = 0.2  # of its sigma: a smaller change of every observed direction ends the rounds
_MIN_ROUNDS, _SIZING_ROUNDS = 3, 2  # rounds at least; rounds in which the size of the LiDAR's noise is still looked for


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRounds:
    """How the rounds ended.

    Parameters
    ----------
    estimate : Estimate
        The last round's.
    observed : Observed
        What the data alone show, as changes from the prior.
    passes : int
        Rounds that were made.
    converged : bool
        Whether the last round changed every observed direction by little against its sigma; False where the rounds
        ended at ``config.calibration.passes``.
    """

    estimate: Estimate
    observed: Observed
    passes: int
    converged: bool


def run_rounds(
    poses: LidarPoses,
    place: Callable[[Estimate], LidarPoses],
    imu: ImuBatch,
    *,
    noise: ImuNoise,
    config: RunConfig,
    prior: RigPrior,
    start: CalibrationState,
    bias: Array,
) -> CalibrationRounds:
    """Estimate in rounds of solving and placing, until no observed direction changes.

    From the second round on the directions that the data do not show are held to the prior, so that the solution does
    not wander along them; the size of the LiDAR's noise is scaled to the residuals in the first rounds.

    Parameters
    ----------
    poses : LidarPoses
        Poses of the LiDAR to begin with.
    place : callable
        Returns the poses of the next round, from an estimate; their covariances may be off by a factor a row.
    imu : ImuBatch
        Inertial samples in the IMU's own clock.
    noise : ImuNoise
        The IMU's noise densities.
    config : RunConfig
        ``calibration.passes`` bounds the rounds, ``calibration.gain`` decides what is observed.
    prior : RigPrior
        Mounting and clock with their information; what the observed directions are changes from.
    start : CalibrationState
        Mounting, clock and gravity to begin with.
    bias : (6,) float64
        Gyroscope [rad/s] and accelerometer bias [m/s^2] to begin with, body axes.

    Returns
    -------
    CalibrationRounds

    Raises
    ------
    CalibrationError
        A round has no solution.
    """
    constrained, change, size = prior, np.zeros(8), np.ones(6)
    for number in range(1, config.calibration.passes + 1):
        found = estimate(
            poses,
            imu,
            noise=noise,
            config=config.imu,
            start=start,
            motion=guess_motion(poses, start, bias),
            prior=constrained,
            rounds=2 if number <= _SIZING_ROUNDS else 1,
        )
        observed = _observe(found, constrained, config)
        before, change = change, observed.observed_part(change_from(prior, found.state))
        converged = number >= _MIN_ROUNDS and _is_small(change - before, observed)
        if converged or number == config.calibration.passes:
            break
        constrained = replace(prior, information=_hold_kept(prior, observed))
        start, bias = found.state, found.motion.bias.mean(axis=0)
        poses = place(found)
        if number > 1:  # the first poses were the odometry's own, whose noise says nothing of the next ones'
            size = size * found.size
        poses = replace(poses, covariance=size[:, None] * poses.covariance * size)
    return CalibrationRounds(estimate=found, observed=observed, passes=number, converged=converged)


def change_from(prior: RigPrior, state: CalibrationState) -> Array:
    """Return what leads from the prior to an estimate, (8,): rotation about and lever arm along imu axes, clock."""
    clock = [state.clock.offset - prior.clock.offset, state.clock.drift - prior.clock.drift]
    return np.concatenate([difference(prior.T_imu_lidar, state.T_imu_lidar), clock])


def _observe(found: Estimate, constrained: RigPrior, config: RunConfig) -> Observed:
    """Return what the data alone tell, with the directions as changes from the prior."""
    sigmas = prior_sigmas(config.calibration)
    G = np.concatenate(found.change_by_calibration, axis=1)
    information = np.linalg.inv(G @ found.covariance @ G.T) - constrained.information
    posterior = np.asarray(np.linalg.inv(information + np.diag(sigmas**-2.0)), dtype=np.float64)
    return analyse(posterior, sigmas, config.calibration.gain)


def _hold_kept(prior: RigPrior, observed: Observed) -> Array:
    """Return the prior's information (8, 8), with the directions that are kept held fast."""
    # The rows of the inverse measure each direction by itself: a motion along the others does not stretch them.
    rows = np.linalg.inv(observed.directions)[observed.kept]
    return np.asarray(prior.information + _HOLD_FACTOR * rows.T @ rows)


def _is_small(step: Array, observed: Observed) -> bool:
    """Whether a change is small against the sigma of every direction that was observed."""
    parts = (np.linalg.inv(observed.directions) @ step)[~observed.kept]
    return bool(np.all(np.abs(parts) * np.sqrt(1.0 + observed.gains[~observed.kept] ** 2) < _CHANGE_TOLERANCE))
