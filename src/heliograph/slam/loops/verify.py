"""Evidence for a candidate loop: registration of the query's local map against the match's, from several starts."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import AlignConfig, LoopConfig
from heliograph.errors import DataError
from heliograph.registration import AlignResult, PreparedCloud, align
from heliograph.slam.loops.records import LoopEvidence, LoopStart, RelativePose
from heliograph.slam.loops.sharpness import joined_blur
from heliograph.slam.loops.submaps import LocalMaps
from heliograph.slam.loops.tangent import diagonal, gate_of, mahalanobis, near

__all__ = ["finished", "guess_distance", "loop_align_config", "verification", "verify", "window_end"]

T = TypeVar("T")

_LEVER_M = 10.0  # distance at which a local map's turn is counted as smear
_MIN_REACH = 2  # keyframes that a local map reaches on either side whatever their smear


def loop_align_config(config: LoopConfig) -> AlignConfig:
    """Return the settings that local maps are prepared and matched with."""
    return AlignConfig(one_sided=True, voxel=config.voxel, levels=config.levels, max_elements=config.elements)


def finished(pieces: Generator[None, None, T]) -> T:
    """Do all pieces of a work and return what it comes to."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            result: T = end.value
            return result


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fitted:
    start: LoopStart
    result: AlignResult
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def T(self) -> Array:
        """The pose found, or the start."""
        found = self.result.T_target_source
        return found if found is not None else self.start.T_match_query

    @property
    def evidence(self) -> float:
        """The share of the smaller overlap that fits; 0 where there is no pose."""
        r = self.result
        return (
            0.0
            if r.T_target_source is None
            else min(r.overlap_source, r.overlap_target) * r.inliers / max(r.matches, 1)
        )


def verify(
    query: int,
    match: int,
    maps: LocalMaps,
    starts: Sequence[LoopStart],
    relative: RelativePose,
    *,
    newest: int,
    config: LoopConfig | None = None,
    score: float = float("nan"),
    sure: bool = False,
    threads: int = 1,
) -> LoopEvidence:
    """Register a query against a candidate from every start that odometry allows, and collect what tells for it.

    Starts that lie within `same` of another are tried once. Of the poses found the one with the most evidence is kept:
    the share of the smaller overlap that fits. A start that odometry's covariance excludes is not tried, but for one by
    hand: where its registration led, it would be refused. Local maps reach as far as odometry is surer than
    `max_smear`, and what it may have bent them is part of the pose's covariance.

    Parameters
    ----------
    query, match : int
        Keyframes.
    maps : LocalMaps
        Prepared with `loop_align_config`.
    starts : sequence of LoopStart
        Guesses, such as a detector's; odometry's own pose is tried first in any case.
    relative : callable
        Keyframes a < b -> odometry's (or the graph's) ``T_a_b`` and its covariance.
    newest : int
        Last keyframe that there is: local maps reach no further.
    config : LoopConfig, optional
    score : float
        Likeness by the detector.
    sure : bool
        Whether ``relative`` knows the way so well that a registration finds the rest: local maps as short as those that
        the pose is taken from are then tried first, and are enough where they overlap.
    threads : int
        The result does not depend on it.

    Raises
    ------
    DataError
        Keyframes out of order.
    """
    return finished(
        verification(
            query, match, maps, starts, relative, newest=newest, config=config, score=score, sure=sure, threads=threads
        )
    )


def verification(
    query: int,
    match: int,
    maps: LocalMaps,
    starts: Sequence[LoopStart],
    relative: RelativePose,
    *,
    newest: int,
    config: LoopConfig | None = None,
    score: float = float("nan"),
    sure: bool = False,
    threads: int = 1,
) -> Generator[None, None, LoopEvidence]:
    """Do what `verify` does in pieces, none of them longer than one registration: a live run goes on in between.

    It yields after each piece, and returns the evidence.
    """
    config = config or LoopConfig()
    if not 0 <= match < query <= newest:
        raise DataError(f"a loop needs an earlier keyframe as match, got query {query}, match {match} of 0 to {newest}")
    prior = relative(match, query)
    tried = _distinct((LoopStart(source="odometry", T_match_query=prior[0]), *starts), prior, config)
    far, short = (_ends(query, match, relative, config, smear) for smear in (config.max_smear, config.fine_smear))
    if sure and short != far:
        fine = yield from _pair(query, match, short, maps, relative)
        result = align(fine.target, fine.source, start=prior[0], config=maps.config, threads=threads)
        yield
        one = _Fitted(start=tried[0], result=result, covariance=_covariance(result, fine.bent, config))
        if result.status == "converged" and min(result.overlap_source, result.overlap_target) >= config.min_overlap:
            evidence = _evidence_of(query, match, one, [one], prior, score, config)
            return _concluded(evidence, fine, maps, config)
    wide = yield from _pair(query, match, far, maps, relative)
    fitted = []
    for start in tried:
        result = align(wide.target, wide.source, start=start.T_match_query, config=maps.config, threads=threads)
        fitted.append(_Fitted(start=start, result=result, covariance=_covariance(result, wide.bent, config)))
        yield
    best = max(fitted, key=lambda one: one.evidence)
    evidence = _evidence_of(query, match, best, fitted, prior, score, config)
    if best.evidence == 0.0:
        return evidence
    if short != far:
        fine = yield from _pair(query, match, short, maps, relative)
        evidence = _refined(evidence, fine, config, maps.config, threads)
        yield
    return _concluded(evidence, wide, maps, config)


def _concluded(evidence: LoopEvidence, pair: _Pair, maps: LocalMaps, config: LoopConfig) -> LoopEvidence:
    poses = maps.submaps.T_odom_imu(evidence.query), maps.submaps.T_odom_imu(evidence.match)
    return with_blur(_with_shift(evidence, *poses), pair.target, pair.source, config)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pair:
    """Local maps of match and query, and the covariance that their bend gives."""

    target: PreparedCloud
    source: PreparedCloud
    bent: Array

    def __post_init__(self) -> None:
        freeze(self)


def _ends(query: int, match: int, relative: RelativePose, config: LoopConfig, smear: float) -> tuple[int, int, int]:
    """Return where the query's local map begins, and where the match's begins and ends."""
    return (
        window_end(query, max(0, query - config.before), relative, smear),
        window_end(match, max(0, match - config.before), relative, smear),
        window_end(match, min(match + config.after, query - 1), relative, smear),
    )


def _pair(
    query: int, match: int, ends: tuple[int, int, int], maps: LocalMaps, relative: RelativePose
) -> Generator[None, None, _Pair]:
    begin, first, last = ends
    for centre, of in ((match, (first, last)), (query, (begin, query))):
        if not maps.holds(centre, *of):
            maps.around(centre, *of)
            yield
    return _Pair(
        target=maps.around(match, first, last),
        source=maps.around(query, begin, query),
        bent=_bent(query, begin, relative) + _bent(match, first, relative),
    )


def _refined(
    evidence: LoopEvidence, fine: _Pair, config: LoopConfig, settings: AlignConfig, threads: int
) -> LoopEvidence:
    """Return the evidence with the pose of smaller local maps, which odometry bends less, where they see enough.

    Where they see another pose the match is ambiguous.
    """
    T = evidence.T_match_query
    result = align(fine.target, fine.source, start=T, config=settings, threads=threads)
    if result.status != "converged" or result.T_target_source is None:
        return evidence
    covariance = _covariance(result, fine.bent, config)
    if not near(T, result.T_target_source, config.same, config.same_deg):
        return replace(evidence, lead=1.0)
    off = evidence.odom_covariance + covariance + diagonal(config.slack_deg, config.slack)
    odom = evidence.T_match_query_odom, result.T_target_source, off
    return replace(
        evidence, T_match_query=result.T_target_source, covariance=covariance, odom_mahalanobis=mahalanobis(*odom)
    )


def _evidence_of(
    query: int,
    match: int,
    best: _Fitted,
    fitted: Sequence[_Fitted],
    prior: tuple[Array, Array],
    score: float,
    config: LoopConfig,
) -> LoopEvidence:
    result = best.result
    return LoopEvidence(
        query=query,
        match=match,
        source=best.start.source,
        status=result.status,
        T_match_query=best.T,
        covariance=best.covariance,
        overlap_query=result.overlap_source,
        overlap_match=result.overlap_target,
        inliers=result.inliers / max(result.matches, 1),
        residuals=result.residuals,
        blind=() if result.observability is None else tuple(str(d) for d in result.observability.blind),
        weakest=0.0 if result.observability is None else float(result.observability.translation[0].information),
        T_match_query_odom=prior[0],
        odom_covariance=prior[1],
        odom_mahalanobis=_off(best, prior, config),
        starts=len(fitted),
        agreeing=sum(near(one.T, best.T, config.same, config.same_deg) for one in fitted if one.evidence > 0.0),
        lead=_lead(best, fitted, prior, config),
        score=score,
    )


def window_end(centre: int, end: int, relative: RelativePose, smear: float) -> int:
    """Return the last keyframe from one towards another that odometry knows better than a smear [m], relative to it.

    The next ones belong to it in any case: a single scan of few beams is not enough.
    """
    at, step = centre, 1 if end > centre else -1
    while at != end:
        if abs(at - centre) < _MIN_REACH:
            at += step
            continue
        first, last = sorted((centre, at + step))
        S = relative(first, last)[1]
        # The smear of what is seen at the lever's end, an axis.
        if np.trace(S[3:, 3:]) / 3.0 + _LEVER_M**2 * np.trace(S[:3, :3]) / 3.0 > smear**2:
            break
        at += step
    return at


def _bent(centre: int, end: int, relative: RelativePose) -> Array:
    """Covariance that a local map's bend gives to a registration by it: that of its middle keyframe."""
    middle = (centre + end) // 2
    return relative(middle, centre)[1] if middle < centre else np.zeros((6, 6))


def _with_shift(evidence: LoopEvidence, T_odom_query: Array, T_odom_match: Array) -> LoopEvidence:
    """Return the evidence with the query's shift and odometry's doubt about it, level and in height."""
    shift = evidence.T_match_query[:3, 3] - evidence.T_match_query_odom[:3, 3]
    x, y, z = T_odom_match[:3, :3] @ shift
    R = T_odom_query[:3, :3]
    S = R @ evidence.odom_covariance[3:, 3:] @ R.T
    level = float(np.linalg.eigvalsh(S[:2, :2])[-1])
    return replace(
        evidence,
        shift_level=float(np.hypot(x, y)),
        shift_up=float(abs(z)),
        doubt_level=float(np.sqrt(max(level, 0.0))),
        doubt_up=float(np.sqrt(max(S[2, 2], 0.0))),
    )


def with_blur(evidence: LoopEvidence, target: PreparedCloud, source: PreparedCloud, config: LoopConfig) -> LoopEvidence:
    """Return the evidence with the blur of joining the local maps where odometry has them, and at the pose."""
    edge = 2.0 * config.voxel
    before = joined_blur(target.points, source.points, evidence.T_match_query_odom, edge)
    after = joined_blur(target.points, source.points, evidence.T_match_query, edge)
    return replace(evidence, blur_before=before, blur_after=after)


def _distinct(starts: Sequence[LoopStart], prior: tuple[Array, Array], config: LoopConfig) -> list[LoopStart]:
    kept: list[LoopStart] = []
    gate = 2.0 * gate_of(config.gate_probability)  # registration may pull it in
    for start in starts:
        allowed = start.source in ("odometry", "hand") or guess_distance(start.T_match_query, prior, config) <= gate
        if allowed and not any(near(start.T_match_query, k.T_match_query, config.same, config.same_deg) for k in kept):
            kept.append(start)
    return kept


def guess_distance(T: Array, prior: tuple[Array, Array], config: LoopConfig) -> float:
    """Return the squared distance from odometry's pose of a guess that is good to a few edges of the finest cubes."""
    return mahalanobis(prior[0], T, prior[1] + diagonal(config.same_deg, 2.0 * config.voxel))


def _off(one: _Fitted, prior: tuple[Array, Array], config: LoopConfig) -> float:
    """Squared distance of a pose from odometry's, in both covariances and the slack."""
    return mahalanobis(prior[0], one.T, prior[1] + one.covariance + diagonal(config.slack_deg, config.slack))


def _lead(best: _Fitted, fitted: Sequence[_Fitted], prior: tuple[Array, Array], config: LoopConfig) -> float:
    gate = gate_of(config.gate_probability)
    others = [
        one.evidence
        for one in fitted
        if not near(one.T, best.T, config.same, config.same_deg) and _off(one, prior, config) <= gate
    ]
    rival = max(others, default=0.0)
    return best.evidence / rival if rival > 0.0 else float("inf")


def _covariance(result: AlignResult, bent: Array, config: LoopConfig) -> Array:
    floor = bent + diagonal(config.sigma_deg, config.sigma)
    return np.asarray(floor if result.covariance is None else config.correlation * result.covariance + floor)
