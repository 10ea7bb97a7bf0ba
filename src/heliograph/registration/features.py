"""Registration of edge and planar points to a map of them: Gauss-Newton on the pose alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import as_pose, freeze
from heliograph.config import FilterConfig, LoamConfig
from heliograph.data.error_layout import POSITION, ROTATION
from heliograph.lie import so3
from heliograph.maps import FeatureMap, FeaturePoints
from heliograph.registration.linearize import NormalEquations
from heliograph.registration.noisy_normals import TrueShare, true_share

__all__ = ["FeatureNoise", "FeatureRegistration", "register_features"]

Array = NDArray[np.float64]

_NOISE_GAIN = 0.2  # share of a new scan's residuals in the noise that is believed


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureNoise:
    """Noise of a feature across its line or plane, as past scans show it.

    Parameters
    ----------
    edge, plane : float
        One-sigma [m].
    """

    edge: float
    plane: float

    def updated(self, registration: FeatureRegistration, config: FilterConfig) -> FeatureNoise:
        """Return the estimate after one more scan."""

        def after(sigma: float, rms: float) -> float:
            if not np.isfinite(rms):
                return sigma
            return float(np.clip(sigma + _NOISE_GAIN * (rms - sigma), config.min_sigma, config.max_sigma))

        return FeatureNoise(
            edge=after(self.edge, registration.edges.rms), plane=after(self.plane, registration.planes.rms)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureRegistration:
    """Where the features fit, and how well.

    Parameters
    ----------
    T_odom_body : (4, 4) float64
        Pose [m].
    edges, planes, sums : NormalEquations
        Sums of either kind and of both, as linearised last, before the last step.
    seen : TrueShare
        What of `sums` is more than noise of the axes can feign.
    iterations : int
    converged : bool
        Whether the last step was within the tolerance, with the kernel at its final width and fresh matches.
    """

    T_odom_body: Array
    edges: NormalEquations
    planes: NormalEquations
    sums: NormalEquations
    seen: TrueShare
    iterations: int
    converged: bool

    def __post_init__(self) -> None:
        freeze(self)


def register_features(
    local_map: FeatureMap,
    points: FeaturePoints,
    T_odom_body: Array,
    *,
    noise: FeatureNoise,
    config: LoamConfig,
    settings: FilterConfig,
    opening: float = 0.0,
    threads: int = 1,
) -> FeatureRegistration:
    """Find the pose at which edge points lie on lines of the map and planar points on planes.

    Each iteration solves eq. (7) of docs/theory/loam.md. Directions that the features do not see stay where the start
    has them (solution remapping: J. Zhang, M. Kaess, S. Singh, "On degeneracy of optimization-based state estimation
    problems", ICRA 2016), and which these are follows from the noise of lines and planes instead of a threshold.

    Parameters
    ----------
    local_map : FeatureMap
    points : FeaturePoints
        Body frame [m].
    T_odom_body : (4, 4) float64
        Where to begin [m].
    noise : FeatureNoise
    config : LoamConfig
    settings : FilterConfig
        Kernel, gate and tolerances.
    opening : float
        Scale of the kernel at first [m]; it halves from iteration to iteration down to ``settings.kernel`` sigmas.
    threads : int
        Threads of the native loops; the result does not depend on them.

    Raises
    ------
    DataError
        A pose that is not finite.
    """
    T = as_pose("T_odom_body", T_odom_body)
    kinds = ((local_map.edges, points.edges, noise.edge), (local_map.planes, points.planes, noise.plane))
    final = settings.kernel * noise.plane
    matches: list[Any] = []
    wide, matched_at, converged, count = max(opening / final, 1.0), T, False, 0
    limit = config.max_iterations + int(np.ceil(np.log2(wide)))
    while count < limit:
        fresh = not matches or _apart(matched_at, T, settings.typical_range) > config.rematch
        if fresh:
            matches, matched_at = [kind.match(p, T, sigma, threads) for kind, p, sigma in kinds], T
        scales = [wide * settings.kernel * sigma for _, _, sigma in kinds]
        edges, planes = (
            _equations(found.sum(p, T, settings.gate * scale, scale, sigma, threads), len(p))
            for found, (_, p, sigma), scale in zip(matches, kinds, scales, strict=True)
        )
        sums = _joined(edges, planes)
        seen = true_share(sums)
        step = -seen.covariance() @ seen.gradient(sums.gradient)  # eq. (7)
        T, count = _moved(T, step), count + 1
        small = (
            float(np.linalg.norm(step[ROTATION])) < settings.tolerance_rotation
            and float(np.linalg.norm(step[POSITION])) < settings.tolerance_position
        )
        if wide <= 1.0 and small:
            converged = _apart(matched_at, T, settings.typical_range) <= config.rematch
            if converged:
                break
        wide = max(0.5 * wide, 1.0)
    return FeatureRegistration(
        T_odom_body=T, edges=edges, planes=planes, sums=sums, seen=seen, iterations=count, converged=converged
    )


def _moved(T: Array, step: Array) -> Array:
    """Return the pose after a right perturbation of the rotation and a step along odom axes."""
    out = np.array(T)
    out[:3, :3] = T[:3, :3] @ so3.exp(step[ROTATION])
    out[:3, 3] += step[POSITION]
    return out


def _apart(a: Array, b: Array, reach: float) -> float:
    """Return how far two poses place a point at a distance of ``reach`` apart at most [m], for small turns."""
    turn = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(2.0)
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]) + reach * turn)


def _equations(sums: Any, queries: int) -> NormalEquations:  # noqa: ANN401
    return NormalEquations(
        blocks=("pose",),
        information=sums.information,
        gradient=sums.gradient,
        feigned=sums.feigned,
        feigned_square=sums.feigned_square,
        weight=sums.weight,
        robust_weight=sums.robust_weight,
        square=sums.square,
        cost=sums.cost,
        matches=sums.matches,
        fallback_matches=0,
        queries=queries,
    )


def _joined(a: NormalEquations, b: NormalEquations) -> NormalEquations:
    """Return the sums over the matches of both."""
    return replace(
        a,
        **{
            name: getattr(a, name) + getattr(b, name)
            for name in (
                "information",
                "gradient",
                "feigned",
                "feigned_square",
                "weight",
                "robust_weight",
                "square",
                "cost",
                "matches",
                "queries",
            )
        },
    )
