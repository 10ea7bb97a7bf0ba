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

__all__ = ["FeatureNoise", "FeatureRegistration", "SweepFeatures", "register_features"]

Array = NDArray[np.float64]

_ALL = np.zeros(0, np.float32)  # shares of points that go with the pose altogether

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
            _equations(found.sum(p, T, _ALL, settings.gate * scale, scale, sigma, threads), len(p))
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


class SweepFeatures:
    """The features of a sweep against a map, linearised about its pose and its steady motion at once.

    Matches are kept as long as the pose moves by less than ``config.rematch``.

    Parameters
    ----------
    local_map : FeatureMap
    before_end : (E,) float32, (P,) float32
        How long before the sweep's end edges and planar points were seen [s].
    noise : FeatureNoise
    config : LoamConfig
    settings : FilterConfig
    threads : int
        Threads of the native loops; the result does not depend on them.
    """

    def __init__(
        self,
        local_map: FeatureMap,
        before_end: tuple[NDArray[np.float32], NDArray[np.float32]],
        *,
        noise: FeatureNoise,
        config: LoamConfig,
        settings: FilterConfig,
        threads: int = 1,
    ) -> None:
        kinds = ((local_map.edges, noise.edge), (local_map.planes, noise.plane))
        self._kinds = [(kind, sigma, before) for (kind, sigma), before in zip(kinds, before_end, strict=True)]
        self._span = max((float(before.max(initial=0.0)) for before in before_end), default=0.0)
        self._config, self._settings, self._threads = config, settings, threads
        self._matches: list[Any] = []
        self._matched_at = np.eye(4)

    def sums(
        self, points: FeaturePoints, T_odom_body: Array, wide: float
    ) -> tuple[NormalEquations, NormalEquations, NormalEquations]:
        """Return the sums of edges, of planar points and of both, their columns pose and motion (`BLOCKS`).

        Parameters
        ----------
        points : FeaturePoints
            Body frame at the sweep's end, de-skewed with the motion at hand [m].
        T_odom_body : (4, 4) float64
            Pose there [m].
        wide : float
            Scale of the kernel, as a multiple of its final one.
        """
        both, settings, T = (points.edges, points.planes), self._settings, T_odom_body
        if not self._matches or _apart(self._matched_at, T, settings.typical_range) > self._config.rematch:
            self._matched_at = T
            self._matches = [
                kind.match(p, T, sigma, self._threads) for (kind, sigma, _), p in zip(self._kinds, both, strict=True)
            ]
        found = [
            self._with_motion(matches, p, T, kind, wide)
            for matches, p, kind in zip(self._matches, both, self._kinds, strict=True)
        ]
        return found[0], found[1], _joined(*found)

    def _with_motion(
        self,
        matches: Any,  # noqa: ANN401
        points: NDArray[np.float32],
        T: Array,
        kind: tuple[Any, float, NDArray[np.float32]],
        wide: float,
    ) -> NormalEquations:
        """Return sums over pose and motion from sums over the pose whose rows are weighed by a share.

        A point seen a time t before the end moves with the velocity by -t and with the gyroscope's bias, which the rate
        has the opposite sign of, by t. Rows weighed by 1, by t and by 1 + t give all three moments of t.
        """
        _, sigma, before_end = kind
        scale, span = wide * self._settings.kernel * sigma, self._span if self._span > 0.0 else 1.0
        late = np.asarray(before_end / np.float32(span), dtype=np.float32)
        pose, square, both = (
            matches.sum(points, T, shares, self._settings.gate * scale, scale, sigma, self._threads)
            for shares in (_ALL, late, np.float32(1.0) + late)
        )
        turn = span * np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])  # motion to pose

        def joined(H0: Array, H2: Array, H: Array) -> Array:
            H1 = 0.5 * (H - H0 - H2)
            return np.asarray(np.block([[H0, H1 @ turn], [turn.T @ H1, turn.T @ H2 @ turn]]))

        return replace(
            _equations(pose, len(points)),
            blocks=("pose", "motion"),
            information=joined(pose.information, square.information, both.information),
            feigned=joined(pose.feigned, square.feigned, both.feigned),
            gradient=np.concatenate([pose.gradient, turn.T @ square.gradient]),
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
