"""Rounds of solving and placing, each from where the last one ended, until nothing that matters changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.calibration.batch import Estimate, estimate, guess_motion
from heliograph.calibration.beliefs import Beliefs, LidarPoses, RigPrior
from heliograph.calibration.observability import Observed, analyse, difference, prior_sigmas
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, ImuNoise

__all__ = ["CalibrationRounds", "change_from", "settle"]

Array = NDArray[np.float64]

_HOLD = 1e4  # how many times the prior's information holds a direction that is kept, while solving
_SETTLED = 0.2  # of its sigma: a smaller change of every observed direction ends the rounds
_FEWEST, _SIZING = 3, 2  # rounds at least; rounds in which the size of the LiDAR's noise is still looked for


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRounds:
    """How the rounds ended.

    Parameters
    ----------
    estimate : Estimate
        Of the last one.
    observed : Observed
        What the data alone told, as changes from the prior.
    passes : int
    settled : bool
    """

    estimate: Estimate
    observed: Observed
    passes: int
    settled: bool


def settle(
    poses: LidarPoses,
    place: Callable[[Estimate], LidarPoses],
    imu: ImuBatch,
    *,
    noise: ImuNoise,
    config: RunConfig,
    prior: RigPrior,
    start: Beliefs,
    bias: Array,
) -> CalibrationRounds:
    """Estimate in rounds.

    Parameters
    ----------
    poses : LidarPoses
        To begin with.
    place : callable
        Returns the poses of the next round, from an estimate; their covariances may be off by a factor a row.
    imu : ImuBatch
    noise : ImuNoise
    config : RunConfig
    prior : RigPrior
    start : Beliefs
        To begin with.
    bias : (6,) float64
        To begin with.
    """
    held, told, size = prior, np.zeros(8), np.ones(6)
    for number in range(1, config.calibration.passes + 1):
        found = estimate(
            poses,
            imu,
            noise=noise,
            config=config.imu,
            start=start,
            motion=guess_motion(poses, start, bias),
            prior=held,
            rounds=2 if number <= _SIZING else 1,
        )
        observed = _observed(found, held, config)
        before, told = told, observed.told(change_from(prior, found.beliefs))
        settled = number >= _FEWEST and _within(told - before, observed)
        if settled or number == config.calibration.passes:
            break
        held = replace(prior, information=_holding(prior, observed))
        start, bias = found.beliefs, found.motion.bias.mean(axis=0)
        poses = place(found)
        if number > 1:  # the first poses were the odometry's own, whose noise says nothing of the next ones'
            size = size * found.size
        poses = replace(poses, covariance=size[:, None] * poses.covariance * size)
    return CalibrationRounds(estimate=found, observed=observed, passes=number, settled=settled)


def change_from(prior: RigPrior, beliefs: Beliefs) -> Array:
    """Return what leads from the prior to the beliefs, (8,): rotation about and lever arm along imu axes, clock."""
    clock = [beliefs.clock.offset - prior.clock.offset, beliefs.clock.drift - prior.clock.drift]
    return np.concatenate([difference(prior.T_imu_lidar, beliefs.T_imu_lidar), clock])


def _observed(found: Estimate, held: RigPrior, config: RunConfig) -> Observed:
    """Return what the data alone tell, with the directions as changes from the prior."""
    sigmas = prior_sigmas(config.calibration)
    G = np.concatenate(found.change_by_calibration, axis=1)
    information = np.linalg.inv(G @ found.covariance @ G.T) - held.information
    posterior = np.asarray(np.linalg.inv(information + np.diag(sigmas**-2.0)), dtype=np.float64)
    return analyse(posterior, sigmas, config.calibration.gain)


def _holding(prior: RigPrior, observed: Observed) -> Array:
    """Return the prior's information (8, 8), with the directions that are kept held fast."""
    # The rows of the inverse measure each direction by itself: a motion along the others does not stretch them.
    rows = np.linalg.inv(observed.directions)[observed.kept]
    return np.asarray(prior.information + _HOLD * rows.T @ rows)


def _within(step: Array, observed: Observed) -> bool:
    """Whether a change is small against the sigma of every direction that the data tell."""
    parts = (np.linalg.inv(observed.directions) @ step)[~observed.kept]
    return bool(np.all(np.abs(parts) * np.sqrt(1.0 + observed.gains[~observed.kept] ** 2) < _SETTLED))
