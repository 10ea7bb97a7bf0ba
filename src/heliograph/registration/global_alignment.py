"""Alignment without a start: features, the matches that agree, hypotheses, and evidence for one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import GlobalAlignConfig
from heliograph.lie import se3, so3
from heliograph.registration.surfaces import PreparedCloud

__all__ = ["Hypothesis", "hypotheses", "truncated_pose"]

Array = NDArray[np.float64]
_GNC_STEP = 1.4
_MAX_GNC = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """A pose that a set of consistent matches makes.

    Parameters
    ----------
    T : (4, 4) float64
        Source to target, between the clouds less their origins.
    support : int
        Matches in the set that the pose explains.
    """

    T: Array
    support: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Keypoints:
    places: NDArray[np.float32]
    normals: NDArray[np.float32]
    features: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self)


def hypotheses(
    target: PreparedCloud, source: PreparedCloud, config: GlobalAlignConfig, threads: int
) -> list[Hypothesis]:
    """Return poses that the features of two clouds suggest; none where none agree.

    Fast point feature histograms (R. Rusu et al., ICRA 2009) are matched both ways; matches that one rigid motion could
    make form sets (maximum cliques: H. Yang, J. Shi, L. Carlone, "TEASER", T-RO 2021, grown greedily here from the
    pairs with the highest second-order compatibility: Z. Chen et al., CVPR 2022); each set gives a pose by truncated
    least squares with graduated non-convexity. That is done on two levels: narrow surroundings tell the places of a
    room apart, and look the same all along a street, where the wide ones do.

    Parameters
    ----------
    target, source : PreparedCloud
    config : GlobalAlignConfig
    threads : int
        The result does not depend on it.
    """
    found: list[Hypothesis] = []
    for scale in _scales(target, config):
        found += _at_scale(target, source, scale, config, threads)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scale:
    level: int
    radius: float
    tolerance: float

    def __post_init__(self) -> None:
        freeze(self)


def _scales(target: PreparedCloud, config: GlobalAlignConfig) -> list[_Scale]:
    top = target.native.levels() - 1
    narrow = _Scale(level=min(config.level, top), radius=config.radius, tolerance=config.tolerance)
    wide = _Scale(level=config.level + 1, radius=config.wide_radius, tolerance=config.wide_tolerance)
    return [narrow, wide] if wide.level <= top else [narrow]


def _at_scale(
    target: PreparedCloud, source: PreparedCloud, scale: _Scale, config: GlobalAlignConfig, threads: int
) -> list[Hypothesis]:
    a, b = (_keypoints(cloud, scale, config, threads) for cloud in (target, source))
    if min(len(a.places), len(b.places)) < 3:
        return []
    pairs = _pairs(a, b, config, threads)
    p, q = b.places[pairs[:, 1]], a.places[pairs[:, 0]]
    n, m = b.normals[pairs[:, 1]], a.normals[pairs[:, 0]]
    tolerance, angle = scale.tolerance, np.radians(config.max_angle_deg)
    found = []
    for members in _core.consistent_sets(p, q, n, m, tolerance, angle, config.seeds, threads):
        T, inliers = truncated_pose(p[members], q[members], tolerance)
        found.append(Hypothesis(T=T, support=int(inliers.sum())))
    found.sort(key=lambda h: -h.support)
    return _distinct(found, config)


def _keypoints(cloud: PreparedCloud, scale: _Scale, config: GlobalAlignConfig, threads: int) -> _Keypoints:
    """Choose the elements whose histograms differ most from the cloud's mean: a wall's middle is like any other."""
    mean, _, axes, *_ = cloud.native.elements(scale.level)
    features = np.asarray(_core.point_features(cloud.native, scale.level, scale.radius, threads))
    lively = features.sum(axis=1) > 0.0
    typical = features[lively].mean(axis=0) if lively.any() else np.zeros(features.shape[1])
    unlike = np.where(lively, ((features - typical) ** 2).sum(axis=1), -1.0)
    order = np.argsort(-unlike, kind="stable")[: config.keypoints]
    chosen = np.sort(order[lively[order]])
    places, normals = np.asarray(mean)[chosen], np.asarray(axes)[chosen, 0]
    away = np.einsum("ij,ij->i", places, normals) > 0.0
    normals = np.where(away[:, None], -normals, normals)
    return _Keypoints(places=places, normals=np.ascontiguousarray(normals), features=features[chosen])


def _pairs(a: _Keypoints, b: _Keypoints, config: GlobalAlignConfig, threads: int) -> NDArray[np.int64]:
    """Return pairs (of a, of b) where each is among the other's nearest, (N, 2)."""
    to_b = _core.nearest_features(a.features, b.features, config.neighbours, threads)
    to_a = _core.nearest_features(b.features, a.features, config.neighbours, threads)
    mutual = np.zeros((len(a.places), len(b.places)), dtype=bool)
    rows = np.repeat(np.arange(len(a.places)), to_b.shape[1])
    mutual[rows[to_b.ravel() >= 0], to_b.ravel()[to_b.ravel() >= 0]] = True
    back = np.zeros_like(mutual)
    columns = np.repeat(np.arange(len(b.places)), to_a.shape[1])
    back[to_a.ravel()[to_a.ravel() >= 0], columns[to_a.ravel() >= 0]] = True
    return np.argwhere(mutual & back)


def truncated_pose(p: NDArray[np.float32], q: NDArray[np.float32], noise: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the motion that takes most of ``p`` to within ``noise`` of ``q``, and which those are.

    Truncated least squares by graduated non-convexity (H. Yang et al., RA-L 2020): the weight of a residual ``r`` is
    1 below ``mu / (mu + 1) c^2``, 0 above ``(mu + 1) / mu c^2``, and falls between; ``mu`` grows.

    Parameters
    ----------
    p, q : (N, 3) float32
        Matched places [m], three or more.
    noise : float
        Largest residual of a match that counts [m].
    """
    P, Q = p.astype(np.float64), q.astype(np.float64)
    w, c2 = np.ones(len(P)), noise**2
    T = _weighted_pose(P, Q, w)
    square = ((se3.act(T, P) - Q) ** 2).sum(axis=1)
    mu = c2 / max(2.0 * float(square.max()) - c2, 1e-12)
    for _ in range(_MAX_GNC):
        high, low = (mu + 1.0) / mu * c2, mu / (mu + 1.0) * c2
        between = np.sqrt(c2 * mu * (mu + 1.0) / np.maximum(square, 1e-18)) - mu
        w = np.where(square >= high, 0.0, np.where(square <= low, 1.0, between))
        if np.count_nonzero(w) < 3 or np.all((w == 0.0) | (w == 1.0)):
            break
        T = _weighted_pose(P, Q, w)
        square = ((se3.act(T, P) - Q) ** 2).sum(axis=1)
        mu *= _GNC_STEP
    return T, square <= c2


def _weighted_pose(P: Array, Q: Array, w: Array) -> Array:
    """Least squares (K. Arun, T. Huang, S. Blostein, PAMI 1987)."""
    total = max(float(w.sum()), 1e-12)
    a, b = (w @ P) / total, (w @ Q) / total
    R = so3.project((Q - b).T @ ((P - a) * w[:, None]))
    return se3.from_rotation_translation(R, b - R @ a)


def _distinct(found: list[Hypothesis], config: GlobalAlignConfig) -> list[Hypothesis]:
    """Drop what is near a better supported pose, and all but the first few."""
    kept: list[Hypothesis] = []
    for h in found:
        if all(_apart(h.T, k.T, config) for k in kept):
            kept.append(h)
        if len(kept) == config.hypotheses:
            break
    return kept


def _apart(A: Array, B: Array, config: GlobalAlignConfig) -> bool:
    d = se3.log(se3.inverse(A) @ B)
    turned = float(np.linalg.norm(d[:3])) > np.radians(config.same_deg)
    return turned or float(np.linalg.norm(A[:3, 3] - B[:3, 3])) > config.same
