"""Links between two runs: places of one in the map of the other, verified as loops are, believed as a set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from heliograph.arrays import Array, Mask, freeze
from heliograph.config import LoopConfig
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.localization import MapPlace, Query, decide, search
from heliograph.merging.sessions import RunSession
from heliograph.registration import align
from heliograph.slam.loops import (
    LocalMaps,
    LoopDecision,
    LoopEvidence,
    agreements,
    diagonal,
    judge,
    judge_together,
    loop_align_config,
)
from heliograph.slam.loops.verify import window_end, with_blur

__all__ = ["Link", "PlaceCounter", "find_links"]

PlaceCounter: TypeAlias = Callable[[int, int], None]
"""Told how many places of a pair of runs have been compared, and of how many."""

_EVERY = 3  # keyframes from query to query
_QUERIES = 12  # queries of a short run, where it has as many keyframes
_CLIQUE = 4  # links of two runs that must agree with each other
_SPAN = 5.0  # way that their queries must cover [m]
_TURN = 3.0  # sigma of a heading of which nothing is known [rad]
_AT_ONCE = 300  # links that are compared


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A place that two runs share.

    Parameters
    ----------
    evidence : LoopEvidence
        ``query`` numbers the keyframes of the one run, ``match`` those of the other.
    decision : LoopDecision
    """

    evidence: LoopEvidence
    decision: LoopDecision

    def __post_init__(self) -> None:
        freeze(self)


def find_links(there: RunSession, here: RunSession, watch: PlaceCounter | None = None) -> tuple[Link, ...]:
    """Return what may link two runs, with the decision about each.

    Every third keyframe of the run ``here``, more of a short one, with the scans of the metres before it, is looked for
    in the map of ``there``. One that several places fit alike links nothing. What is found is registered by local maps
    as a loop is, and judged by what a loop is judged by, but for odometry, which knows nothing of another run. Links
    are believed together: a set that agrees pair by pair (over the ways in both runs), is large enough, covers enough
    way, and is larger by as much than any set that contradicts it.

    Parameters
    ----------
    there, here : RunSession
        Match and query.
    watch : callable, optional
        Told which of how many queries has been looked at.
    """
    config = _loop_config(here.run.config.loops)
    every = max(1, min(_EVERY, len(here) // _QUERIES))
    found = []
    for k in range(0, len(here), every):
        evidence = _linked(there, here, k, config)
        found += [] if evidence is None else [evidence]
        if watch is not None:
            watch(k // every + 1, -(-len(here) // every))
    loops: list[LoopEvidence] = []
    decisions: list[LoopDecision] = []
    refused: list[Link] = []
    for evidence in found:
        decision = judge(evidence, config)
        if decision.verdict == "held":
            loops.append(evidence)
            decisions.append(decision)
        else:
            refused.append(Link(evidence=evidence, decision=decision))
    loops, decisions = loops[:_AT_ONCE], decisions[:_AT_ONCE]
    agree = _agreement(loops, there, here, config)
    together = judge_together(loops, decisions, agree, here.relative, config)
    links = [Link(evidence=e, decision=d) for e, d in zip(loops, together, strict=True)]
    return tuple(sorted((*links, *refused), key=lambda link: link.evidence.query))


def _loop_config(config: LoopConfig) -> LoopConfig:
    return replace(config, min_clique=max(_CLIQUE, config.min_clique))


def _linked(there: RunSession, here: RunSession, index: int, config: LoopConfig) -> LoopEvidence | None:
    """Return the evidence of the one place in the other run where a keyframe was taken; None where it is not known."""
    told = here.run.config.localization
    T_map_level, points = here.around(index, told.before)
    try:
        query = Query.of(points, there.saved(), there.run.config.localization)
    except DataError:  # a few points on a line
        return None
    found = search(query, there.saved(), told)
    standing = decide(found, told)
    if len(standing) != 1 or not standing[0].held:
        return None
    T = np.ascontiguousarray(standing[0].T_map_level @ se3.inverse(T_map_level) @ here.T_map_imu[index])
    rival = max((place.score for place in found if place is not standing[0]), default=0.0)
    lead = standing[0].score / rival if rival > 0.0 else float("inf")
    return _verified(there, here, index, T, standing[0], lead, config)


def _verified(
    there: RunSession, here: RunSession, query: int, T: Array, place: MapPlace, lead: float, config: LoopConfig
) -> LoopEvidence | None:
    """Register local maps as those of a loop, from a place that was found."""
    match = _nearest(there, T)
    settings = loop_align_config(config)
    far, near = _ends(there, match, config, both=True), _ends(here, query, config, both=False)
    target = LocalMaps(there, settings, kept=1).around(match, *far)
    source = LocalMaps(here, settings, kept=1).around(query, *near)
    start = np.ascontiguousarray(se3.inverse(there.T_map_imu[match]) @ T)
    result = align(target, source, start=start, config=settings)
    if result.T_target_source is None or result.covariance is None:
        return None
    evidence = LoopEvidence(
        query=query,
        match=match,
        source="place",
        status=result.status,
        T_match_query=result.T_target_source,
        covariance=config.correlation * result.covariance
        + diagonal(config.sigma_deg, config.sigma)
        + _bent(there, match, far[0])
        + _bent(here, query, near[0]),
        overlap_query=result.overlap_source,
        overlap_match=result.overlap_target,
        inliers=result.inliers / max(result.matches, 1),
        residuals=result.residuals,
        blind=() if result.observability is None else tuple(str(d) for d in result.observability.blind),
        weakest=0.0 if result.observability is None else float(result.observability.translation[0].information),
        T_match_query_odom=result.T_target_source,
        odom_covariance=np.diag(np.repeat([_TURN, _SPAN / config.min_span], 3) ** 2),
        odom_mahalanobis=0.0,
        starts=1,
        agreeing=1,
        lead=lead,
        score=place.score,
    )
    return with_blur(evidence, target, source, config)


def _ends(session: RunSession, centre: int, config: LoopConfig, *, both: bool) -> tuple[int, int]:
    """Return the first and last keyframe of a local map; a query has none after it."""
    first = window_end(centre, max(0, centre - config.before), session.relative, config.fine_smear)
    last = min(centre + config.after, len(session) - 1) if both else centre
    return first, window_end(centre, last, session.relative, config.fine_smear)


def _bent(session: RunSession, centre: int, end: int) -> Array:
    """Return the covariance that a local map's bend gives to a registration by it: that of its middle keyframe."""
    middle = (centre + end) // 2
    return session.relative(middle, centre)[1] if middle < centre else np.zeros((6, 6))


def _nearest(session: RunSession, T: Array) -> int:
    """Return the keyframe that should share most with a pose: near by, and seen in the same direction."""
    apart = np.linalg.norm(session.T_map_imu[:, :3, 3] - T[:3, 3], axis=1)
    turned = 1.0 - np.einsum("nij,ij->n", session.T_map_imu[:, :3, :3], T[:3, :3]) / 3.0
    return int(np.argmin(apart + 30.0 * turned))


def _agreement(loops: list[LoopEvidence], there: RunSession, here: RunSession, config: LoopConfig) -> Mask:
    """Return which links agree pair by pair, (N, N) bool.

    Keyframes of the two runs have their numbers one behind the other, so that a way is asked of the run that it is in.
    """
    offset = len(there)

    def relative(a: int, b: int) -> tuple[Array, Array]:
        if a < offset:
            return there.relative(a, b)
        return here.relative(a - offset, b - offset)

    numbered = [replace(loop, query=loop.query + offset) for loop in loops]
    agree = np.eye(len(loops), dtype=bool)
    for i, loop in enumerate(numbered):
        agree[i, :i] = agree[:i, i] = agreements(loop, numbered[:i], relative, config)
    return agree
