"""How far a sweep is from the motion of one velocity and one rate that a filter without an IMU makes of it.

What velocity and rate change by within a sweep bends the cloud, and all matches share that error: the fit to the whole
settles between beginning and end, and its pose at the end misses by what a line through the true motion misses there.
The cloud itself tells: each third of it, in time, is matched by itself, and a motion that is a line to all three leaves
nothing to correct. Where they disagree, with corrections d_1 (the last third), d_2, d_3, the second difference is that
of a parabola ``a s^2 / 2`` over thirds of T, ``a T^2 / 9``, and a line fitted to the parabola misses its end by
``a T^2 / 12``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import POSE, POSE_DIM, POSITION, ROTATION
from heliograph.maps import LocalMap
from heliograph.odometry.filter.error_state import local, retract
from heliograph.registration import MatchSettings, linearize

__all__ = ["CLOUD_BENT", "SweepBend", "sweep_bend"]

CLOUD_BENT = 0.2
"""Mean square of what a parabola less its line is over a sweep, ``(a T^2)^2 / 720``, by the square of what it is at the
end: that much of a bent sweep's error the whole cloud has, and takes to the map."""

_SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0])
_MISSED = 9.0 / 12.0  # of a second difference, at the end
_STEPS = 2  # of Gauss-Newton, from where the whole sweep was fitted
_LEAST_INFORMATION = 1.0  # of a third that sees nothing: a sigma of a radian and a metre


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepBend:
    """What the pose at a sweep's end misses by, as its thirds tell it, without what chance makes of them.

    Parameters
    ----------
    turn : float
        Root of the mean square of an axis [rad].
    move : float
        Likewise [m].
    shift : float
        What it displaces a point by that is as far as the cloud's usually are [m].
    forgiven : float
        What a match forgives [m].
    """

    turn: float
    move: float
    shift: float
    forgiven: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def beyond_model(self) -> bool:
        """Whether the motion is so unsteady that points are displaced farther than a match forgives."""
        return self.shift > self.forgiven


def sweep_bend(
    points_imu: NDArray[np.float32],
    before_end: NDArray[np.float32],
    state: NavState,
    local_map: LocalMap,
    settings: MatchSettings,
    *,
    correlation: float,
    forgiven: float,
) -> SweepBend:
    """Return how far a sweep is bent from the motion that it was de-skewed with.

    Parameters
    ----------
    points_imu : (N, 3) float32
        De-skewed to the sweep's end, imu frame there [m].
    before_end : (N,) float32
        Time of each point before the end [s].
    state : NavState
        Fitted to them.
    local_map : LocalMap
        What they were matched to.
    settings : MatchSettings
        Wide enough that bent points are not shut out.
    correlation : float
        How many matches tell as much as one.
    forgiven : float
        Largest residual of a match as it counts at last [m].
    """
    third = float(before_end.max(initial=0.0)) / 3.0
    if third <= 0.0:
        return SweepBend(turn=0.0, move=0.0, shift=0.0, forgiven=forgiven)
    number = np.minimum((before_end / third).astype(np.int64), 2)
    missed, chance = np.zeros(POSE_DIM), np.zeros((POSE_DIM, POSE_DIM))
    for k, weight in enumerate(_MISSED * _SECOND_DIFFERENCE):
        own, spread = _own_pose(points_imu[number == k], state, local_map, settings)
        missed += weight * own
        chance += weight**2 * correlation * spread
    turn, move = (_beyond_chance(missed[part], chance[part, part]) for part in (ROTATION, POSITION))
    far = float(np.sqrt(np.einsum("ij,ij->", points_imu, points_imu, dtype=np.float64) / len(points_imu)))
    return SweepBend(
        turn=turn, move=move, shift=float(np.sqrt(2.0 * (far * turn) ** 2 + 3.0 * move**2)), forgiven=forgiven
    )


def _own_pose(
    points_imu: NDArray[np.float32], state: NavState, local_map: LocalMap, settings: MatchSettings
) -> tuple[Array, Array]:
    """Return the correction (6,) of the pose with which points fit by themselves, and its covariance (6, 6)."""
    at, prior = state, _LEAST_INFORMATION * np.eye(POSE_DIM)
    for _ in range(_STEPS):
        sums = linearize(local_map, points_imu, at.T_odom_imu, settings)
        spread = np.linalg.inv(sums.information + prior)
        at = retract(at, np.pad(-spread @ sums.gradient, (0, len(at.covariance) - POSE_DIM)))
    return local(state, at)[POSE], np.asarray(spread, np.float64)


def _beyond_chance(missed: Array, chance: Array) -> float:
    return float(np.sqrt(max(float(missed @ missed) - float(np.trace(chance)), 0.0) / len(missed)))
