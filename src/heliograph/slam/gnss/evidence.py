"""What is judged about fixes, and what comes of it: plain records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, freeze
from heliograph.lie import se3

__all__ = ["LEAST_WEIGHT", "FixEvidence", "Judgement", "Placement"]

LEAST_WEIGHT = 0.1
"""A fix that counts for less is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Where the body was when fixes were taken, seen from keyframes.

    Parameters
    ----------
    keyframe : (M,) int64
        Nearest keyframe.
    T_keyframe_body : (M, 4, 4) float64
        Body at the fix's instant in that keyframe's frame, by the odometry.
    covered : (M,) bool
        Whether the odometry knows.
    """

    keyframe: NDArray[np.int64]
    T_keyframe_body: Array
    covered: Mask

    def __post_init__(self) -> None:
        freeze(self)

    def points(self, arm: Array) -> Array:
        """Return a point of the body (3,) in the keyframes' frames, (M, 3)."""
        return np.asarray(se3.act(self.T_keyframe_body, arm))


@dataclass(frozen=True, slots=True, kw_only=True)
class FixEvidence:
    """The odometry's chain of keyframes, loops that stand, and the fixes.

    Parameters
    ----------
    T_odom_imu : (K, 4, 4) float64
        Keyframes.
    step_covariances : (K, 6, 6) float64
        Covariances of the step to each from the one before.
    loops : tuple of (int, int, (4, 4), (6, 6))
        ``i, j, T_i_j`` and its covariance.
    seconds : (M,) float64
        Times of the fixes, ascending [s].
    p_enu : (M, 3) float64
        [m].
    covariance : (M, 3, 3) float64
        As weighed before it is judged [m^2].
    solutions : (M,) str
    placed : callable
        Delay of the stamps [s] -> `Placement`.
    arm : (3,) float64
        Antenna in the imu frame, or where it is thought to be [m].
    arm_sigma : float
        Zero where it is given [m].
    level_sigma : float
        How far odom's z axis may be off the vertical [rad]; infinite where nothing tells.
    """

    T_odom_imu: Array
    step_covariances: Array
    loops: tuple[tuple[int, int, Array, Array], ...]
    seconds: Array
    p_enu: Array
    covariance: Array
    solutions: NDArray[np.str_]
    placed: Callable[[float], Placement]
    arm: Array
    arm_sigma: float
    level_sigma: float

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What the fixes told.

    Parameters
    ----------
    placement : Placement
        At the stamps less the delay.
    weights : (M,) float64
        0 to 1.
    covariance : (M, 3, 3) float64
        To weigh with [m^2].
    squared : (M,) float64
        Squared whitened residuals.
    residual : (M, 3) float64
        Estimated antenna less fix [m].
    threshold : float
        That `squared` was held against.
    T_map_enu : (4, 4) float64
    covariance_enu : (6, 6) float64
        Covariance of a right perturbation of it.
    arm, arm_sigma : (3,) float64
        [m].
    delay, delay_sigma : float
        Taken out of the stamps; sigma NaN where it was not told [s].
    noise_scale, odometry_scale : float
        What reported sigmas and the odometry's were multiplied with.
    """

    placement: Placement
    weights: Array
    covariance: Array
    squared: Array
    residual: Array
    threshold: float
    T_map_enu: Array
    covariance_enu: Array
    arm: Array
    arm_sigma: Array
    delay: float
    delay_sigma: float
    noise_scale: float
    odometry_scale: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def heading_sigma(self) -> float:
        """One-sigma of the map's heading [rad]."""
        return float(np.sqrt(self.covariance_enu[2, 2]))

    @property
    def used(self) -> Mask:
        """Fixes (M,) that count."""
        return self.weights > LEAST_WEIGHT
