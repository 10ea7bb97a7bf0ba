"""Evidence for a candidate loop: registration of the query's local map against the match's, from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import AlignConfig, LoopConfig
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.registration import AlignResult, PreparedCloud, align
from heliograph.slam.loops.records import LoopEvidence, LoopStart
from heliograph.slam.loops.sharpness import joined_blur
from heliograph.slam.loops.submaps import LocalMaps
from heliograph.slam.loops.tangent import mahalanobis, near

__all__ = ["loop_align_config", "verify"]


def loop_align_config(config: LoopConfig) -> AlignConfig:
    """Return the settings that local maps are prepared and matched with."""
    return AlignConfig(one_sided=False, voxel=config.voxel, levels=config.levels)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fitted:
    start: LoopStart
    result: AlignResult
    T: Array
    evidence: float

    def __post_init__(self) -> None:
        freeze(self)


def verify(
    query: int,
    match: int,
    maps: LocalMaps,
    starts: Sequence[LoopStart],
    prior: tuple[Array, Array],
    *,
    newest: int,
    config: LoopConfig | None = None,
    score: float = float("nan"),
    threads: int = 1,
) -> LoopEvidence:
    """Register a query against a candidate from every start that odometry allows, and collect what tells for it.

    Starts that lie within `same` of another are tried once. Of the poses found the one with the most evidence is kept:
    the share of the smaller overlap that fits. A start that odometry's covariance excludes is not tried, but for one by
    hand: where its registration led, it would be refused.

    Parameters
    ----------
    query, match : int
        Keyframes.
    maps : LocalMaps
        Prepared with `loop_align_config`.
    starts : sequence of LoopStart
        Guesses, such as a detector's; odometry's own pose is tried first in any case.
    prior : (T_match_query, covariance)
        Odometry's (or the graph's) relative pose (4, 4) and its covariance (6, 6), right perturbation.
    newest : int
        Last keyframe that there is: local maps reach no further.
    config : LoopConfig, optional
    score : float
        Likeness by the detector.
    threads : int
        The result does not depend on it.

    Raises
    ------
    DataError
        A covariance that is not positive, or keyframes out of order.
    """
    config = config or LoopConfig()
    if not 0 <= match < query <= newest:
        raise DataError(f"a loop needs an earlier keyframe as match, got query {query}, match {match} of 0 to {newest}")
    T_odom, covariance_odom = prior
    settings = maps.config
    source = maps.around(query, max(0, query - config.before), query)
    target = maps.around(match, max(0, match - config.before), min(match + config.after, query - 1))
    fitted = []
    for start in _distinct((LoopStart(source="odometry", T_match_query=T_odom), *starts), prior, config):
        result = align(target, source, start=start.T_match_query, config=settings, threads=threads)
        T = result.T_target_source if result.T_target_source is not None else start.T_match_query
        fitted.append(_Fitted(start=start, result=result, T=T, evidence=_evidence(result)))
    best = max(fitted, key=lambda one: one.evidence)
    covariance = _covariance(best.result, config)
    evidence = LoopEvidence(
        query=query,
        match=match,
        source=best.start.source,
        status=best.result.status,
        T_match_query=best.T,
        covariance=covariance,
        overlap_query=best.result.overlap_source,
        overlap_match=best.result.overlap_target,
        inliers=best.result.inliers / max(best.result.matches, 1),
        residuals=best.result.residuals,
        blind=_blind(best.result),
        weakest=_weakest(best.result),
        T_match_query_odom=T_odom,
        odom_covariance=covariance_odom,
        odom_mahalanobis=mahalanobis(T_odom, best.T, covariance_odom + covariance),
        starts=len(fitted),
        agreeing=sum(near(one.T, best.T, config.same, config.same_deg) for one in fitted if one.evidence > 0.0),
        lead=_lead(best, fitted, prior, config),
        score=score,
    )
    return with_blur(evidence, target, source, config) if best.evidence > 0.0 else evidence


def with_blur(
    evidence: LoopEvidence, target: PreparedCloud, source: PreparedCloud, config: LoopConfig
) -> LoopEvidence:
    """Return the evidence with the blur of joining the local maps where odometry has them, and at the pose."""
    edge = 2.0 * config.voxel
    before = joined_blur(target.points, source.points, evidence.T_match_query_odom, edge)
    after = joined_blur(target.points, source.points, evidence.T_match_query, edge)
    return replace(evidence, blur_before=before, blur_after=after)


def _distinct(
    starts: Sequence[LoopStart], prior: tuple[Array, Array], config: LoopConfig
) -> list[LoopStart]:
    kept: list[LoopStart] = []
    gate = 2.0 * chi_square_quantile(config.gate_probability, 6)  # a guess is off by a cell, and may be pulled in
    for start in starts:
        allowed = start.source in ("odometry", "hand") or _outside(start.T_match_query, prior, config) <= gate
        if allowed and not any(near(start.T_match_query, k.T_match_query, config.same, config.same_deg) for k in kept):
            kept.append(start)
    return kept


def _outside(T: Array, prior: tuple[Array, Array], config: LoopConfig) -> float:
    """Squared distance from odometry's pose of a guess that is good to a few edges of the finest cubes."""
    sigma = np.concatenate([np.full(3, np.radians(config.same_deg)), np.full(3, 2.0 * config.voxel)])
    return mahalanobis(prior[0], T, prior[1] + np.diag(sigma**2))


def _evidence(result: AlignResult) -> float:
    if result.T_target_source is None:
        return 0.0
    return min(result.overlap_source, result.overlap_target) * result.inliers / max(result.matches, 1)


def _lead(best: _Fitted, fitted: Sequence[_Fitted], prior: tuple[Array, Array], config: LoopConfig) -> float:
    gate = chi_square_quantile(config.gate_probability, 6)
    others = [
        one.evidence
        for one in fitted
        if not near(one.T, best.T, config.same, config.same_deg)
        and mahalanobis(prior[0], one.T, prior[1] + _covariance(one.result, config)) <= gate
    ]
    rival = max(others, default=0.0)
    return best.evidence / rival if rival > 0.0 else float("inf")


def _covariance(result: AlignResult, config: LoopConfig) -> Array:
    floor = np.diag(np.repeat([np.radians(config.sigma_deg), config.sigma], 3) ** 2)
    return floor if result.covariance is None else np.asarray(result.covariance + floor)


def _blind(result: AlignResult) -> tuple[str, ...]:
    return () if result.observability is None else tuple(str(d) for d in result.observability.blind)


def _weakest(result: AlignResult) -> float:
    return 0.0 if result.observability is None else float(result.observability.translation[0].information)
