"""A first guess of where the map lies in east-north-up: heading and origin from two tracks, outliers or not."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Mask

__all__ = ["aligned_tracks", "noise_scale"]

_ROUNDS = 30
_NEXT = 2.5  # seconds between fixes that follow each other
_FEWEST_PAIRS = 20
_MEDIAN_OF_NORMAL = 0.6745


def aligned_tracks(p_odom: Array, p_enu: Array, sigma: Array, *, level: bool) -> Array:
    """Return ``T_enu_odom`` (4, 4) that brings one track onto the other, by least absolute distances.

    Parameters
    ----------
    p_odom, p_enu : (N, 3) float64
        The antenna by the odometry and by the receiver, at the same instants [m].
    sigma : (N,) float64
        One-sigma of the fixes [m].
    level : bool
        Whether odom's z axis points up, so that only a heading is to be found; else a whole rotation.

    Notes
    -----
    Weights ``1 / max(d, sigma)`` of the distances d make the sum of squares one of distances (iteratively reweighted
    least squares); each round is the closed form of K. S. Arun, T. S. Huang, S. D. Blostein (PAMI 1987), or its plane
    counterpart.
    """
    weights, T = 1.0 / sigma, np.eye(4)
    for _ in range(_ROUNDS):
        before = T
        T = _closed_form(p_odom, p_enu, weights, level=level)
        off = np.linalg.norm(p_odom @ T[:3, :3].T + T[:3, 3] - p_enu, axis=1)
        weights = 1.0 / (np.maximum(off, sigma) * sigma)
        if np.abs(T - before).max() < 1e-6:
            break
    return T


def _closed_form(a: Array, b: Array, weights: Array, *, level: bool) -> Array:
    share = weights / weights.sum()
    mean_a, mean_b = share @ a, share @ b
    S = (a - mean_a).T @ (share[:, None] * (b - mean_b))
    T = np.eye(4)
    if level:
        angle = np.arctan2(S[0, 1] - S[1, 0], S[0, 0] + S[1, 1])
        c, s = np.cos(angle), np.sin(angle)
        T[:2, :2] = [[c, -s], [s, c]]
    else:
        U, _, Vt = np.linalg.svd(S)
        flip = np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)])
        T[:3, :3] = Vt.T @ flip @ U.T
    T[:3, 3] = mean_b - T[:3, :3] @ mean_a
    return T


def noise_scale(p_odom: Array, p_enu: Array, seconds: Array, sigma: Array, same: Mask) -> float:
    """Return how much larger the noise between consecutive fixes is than reported; 1 where it is not, or too few tell.

    Between two fixes that follow each other the odometry is exact: what is left of their difference is the receiver's
    noise, whatever its offset. The median does not see the few that jump.

    Parameters
    ----------
    p_odom : (N, 3) float64
        The antenna by the odometry, turned to east-north-up [m].
    p_enu : (N, 3) float64
        Fixes [m].
    seconds : (N,) float64
        Their times [s].
    sigma : (N, 3) float64
        Reported one-sigma [m].
    same : (N,) bool
        Fixes to look at.
    """
    k = np.flatnonzero(same)
    pair = k[:-1][(np.diff(k) == 1) & (np.diff(seconds[k]) < _NEXT)] if len(k) > 1 else k[:0]
    if len(pair) < _FEWEST_PAIRS:
        return 1.0
    d = (p_enu[pair + 1] - p_enu[pair]) - (p_odom[pair + 1] - p_odom[pair])
    white = np.hypot(sigma[pair], sigma[pair + 1])
    return max(1.0, float(np.median(np.abs(d / white)) / _MEDIAN_OF_NORMAL))
