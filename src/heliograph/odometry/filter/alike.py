"""How many matches of a scan tell as much as one, by what the scans themselves show.

Noise of single points is independent from match to match, and in simulation nothing else errs within a scan. A sensor
does more: beams that each measure too short or too long, a sweep bent by a motion that nobody sampled, a map that was
bent so. What is near then errs alike, over metres. The residuals tell: sums of the score over cubes have the covariance
that they would have if all matches were independent, or a multiple of it. That is the sandwich of generalized
estimating equations (K.-Y. Liang, S. Zeger, "Longitudinal data analysis using generalized linear models", 1986) with
cubes in place of subjects, and what they call the design effect of clusters.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.data import NavState
from heliograph.data.error_layout import POSE_DIM, POSITION, ROTATION
from heliograph.maps import LocalMap, VoxelMap
from heliograph.registration import MatchSettings
from heliograph.snapshots import Stateful

__all__ = ["AlikeErrors", "design_effect"]

_EACH = 5  # scans of which one is looked at: it is a trait of sensor and place, not of a scan
_ASKED = 1000  # points whose residuals are looked at
_GAIN = 0.1  # weight of the latest look in the running mean of the logarithm, at least
_BEFORE = 2  # looks that "as if independent" counts as at the beginning
_FEWEST = 100  # matches that are looked at
_LEAST = 1e-9  # information along a direction by the mean of all, below which it is none


class AlikeErrors(Stateful):
    """A running mean of how many times more the errors of a scan's matches are than if all were independent.

    Parameters
    ----------
    edge : float
        Edge of the cubes in which matches may err alike [m].
    """

    _STATE: ClassVar = {
        "_log": float,
        "_scans": int,
        "_looks": int,
    }

    def __init__(self, edge: float) -> None:
        self._edge = edge
        self._log = 0.0
        self._scans = self._looks = 0

    @property
    def factor(self) -> float:
        """How many matches tell as much as one where errors are independent; at least 1."""
        return float(np.exp(max(self._log, 0.0)))

    def learn(
        self, local_map: LocalMap, points_imu: NDArray[np.float32], state: NavState, settings: MatchSettings
    ) -> None:
        """Look at the matches of a scan, once in `_EACH`.

        Parameters
        ----------
        local_map : LocalMap
            As the scan was matched.
        points_imu : (N, 3) float32
            What was matched, imu frame at the sweep's end [m].
        state : NavState
            The scan's final state.
        settings : MatchSettings
            How matches are made at last.
        """
        self._scans += 1
        if self._scans % _EACH:
            return
        effect = design_effect(local_map, points_imu, state, settings, self._edge)
        if effect is not None:
            self._looks += 1
            self._log += max(_GAIN, 1.0 / (_BEFORE + self._looks)) * (float(np.log(effect)) - self._log)


def design_effect(
    local_map: LocalMap, points_imu: NDArray[np.float32], state: NavState, settings: MatchSettings, edge: float
) -> float | None:
    """Return how many times more the score of a scan scatters, by sums over cubes, than by single matches.

    Both in units of the information, on average over the directions of the pose; None where too little matches. The
    parameters are those of `AlikeErrors.learn`, and the edge of the cubes [m].
    """
    stride = max(1, len(points_imu) // _ASKED)
    p, R = points_imu[::stride].astype(np.float64), state.R_odom_imu
    at = p @ R.T + state.p_odom
    if isinstance(local_map, VoxelMap):
        found = local_map.planes_at(at, gate=settings.gate, neighbours=False)
    else:
        found = local_map.planes_at(at, gate=settings.gate)
    some = found.source > 0
    if np.count_nonzero(some) < _FEWEST:
        return None
    n, at = found.normal[some].astype(np.float64), at[some]
    r = np.einsum("ij,ij->i", n, at - found.point[some])
    w = (settings.kernel**2 / (settings.kernel**2 + r * r)) ** 2 / (settings.sigma**2 + found.variance[some])
    J = np.zeros((len(n), POSE_DIM))
    J[:, ROTATION], J[:, POSITION] = np.cross(p[some], n @ R), n
    score = (J * (w * r)[:, None]) @ _whitening((J * w[:, None]).T @ J)
    keys = np.floor(at / edge).astype(np.int64) @ np.array([1 << 42, 1 << 21, 1])
    order = np.argsort(keys, kind="stable")
    begins = np.flatnonzero(np.diff(keys[order], prepend=keys[order[0]] - 1))
    cubes = np.add.reduceat(score[order], begins)
    own, together = float(np.sum(score**2)), float(np.sum(cubes**2))
    # One in `stride` was asked: each has as many neighbours more.
    return max(1.0 + stride * (together / own - 1.0), 1.0 / stride) if own > 0.0 else None


def _whitening(information: Array) -> Array:
    """Return W with ``W^T A W = 1`` over what an information A holds."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    held = values > _LEAST
    return np.asarray(scale[:, None] * vectors * np.where(held, 1.0 / np.sqrt(np.where(held, values, 1.0)), 0.0))
