"""Decisions about loops, from records alone: one by one what is wrong, and together what is right."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array, Mask
from heliograph.config import LoopConfig
from heliograph.slam.loops.consistency import cycle_mahalanobis, maximum_clique
from heliograph.slam.loops.records import LoopDecision, LoopEvidence, RelativePose
from heliograph.slam.loops.tangent import diagonal, gate_of

__all__ = ["agreements", "judge", "judge_together"]


def judge(evidence: LoopEvidence, config: LoopConfig | None = None) -> LoopDecision:
    """Decide about one candidate by itself: it is rejected, or held; nothing is accepted alone.

    Parameters
    ----------
    evidence : LoopEvidence
    config : LoopConfig, optional
    """
    c = config or LoopConfig()
    e = evidence
    if e.status not in ("converged", "degenerate"):
        return LoopDecision(verdict="rejected", reason="no-pose", numbers={"overlap": e.overlap})
    gate = gate_of(c.gate_probability)
    if not e.odom_mahalanobis <= gate:
        off = {"chi2": e.odom_mahalanobis, "allowed": gate, "distance_m": e.disagreement}
        return LoopDecision(verdict="rejected", reason="odometry", numbers=off)
    limits = (e.shift_level / c.max_shift, e.shift_up / c.max_shift_up,
              e.doubt_level / c.max_doubt, e.doubt_up / c.max_doubt_up)  # fmt: skip
    if max(limits) > 1.0:
        numbers = {"shift_m": e.shift_level, "shift_up_m": e.shift_up, "doubt_m": e.doubt_level,
                   "doubt_up_m": e.doubt_up}  # fmt: skip
        return LoopDecision(verdict="rejected", reason="twin", numbers=numbers)
    if e.overlap < c.min_overlap:
        numbers = {"query": e.overlap_query, "match": e.overlap_match, "needed": c.min_overlap}
        return LoopDecision(verdict="rejected", reason="overlap", numbers=numbers)
    if e.inliers < c.min_inliers or e.residuals.median > c.max_residual * c.voxel:
        numbers = {"inliers": e.inliers, "needed": c.min_inliers, "median_m": e.residuals.median,
                   "allowed_m": c.max_residual * c.voxel}  # fmt: skip
        return LoopDecision(verdict="rejected", reason="fit", numbers=numbers)
    if len(e.blind) > c.max_blind:
        return LoopDecision(verdict="rejected", reason="blind", numbers={"directions": len(e.blind)})
    if e.blur_after > max(c.max_blur, c.max_blur_ratio * e.blur_before):
        numbers = {"before": e.blur_before, "after": e.blur_after, "allowed": c.max_blur}
        return LoopDecision(verdict="rejected", reason="blur", numbers=numbers)
    if e.lead < c.min_lead:
        return LoopDecision(verdict="held", reason="ambiguous", numbers={"lead": e.lead, "needed": c.min_lead})
    return LoopDecision(verdict="held", reason="alone")


def agreements(
    evidence: LoopEvidence, others: Sequence[LoopEvidence], relative: RelativePose, config: LoopConfig | None = None
) -> Mask:
    """Return which of the others close a cycle with this loop that odometry allows, (N,)."""
    c = config or LoopConfig()
    slack = diagonal(c.slack_deg, c.slack)
    return np.asarray(cycle_mahalanobis(evidence, others, relative, slack) <= gate_of(c.consistency_probability))


def judge_together(
    loops: Sequence[LoopEvidence],
    decisions: Sequence[LoopDecision],
    agree: Mask,
    relative: RelativePose,
    config: LoopConfig | None = None,
) -> tuple[LoopDecision, ...]:
    """Decide anew about loops that are held or accepted, by the largest set that agrees pair by pair.

    A held loop is accepted when it belongs to that set, the set is large enough, it leads the largest set of the other
    loops by as many as a set must have at all, and enough of it are of the loop's own sequence: other queries close by
    on the way, which must cover more way where odometry knows less. Ambiguous loops count for nobody, and follow the
    others. An accepted loop that most of such a set contradicts is revoked.

    Parameters
    ----------
    loops : sequence of LoopEvidence
    decisions : sequence of LoopDecision
        Theirs so far: held or accepted.
    agree : (N, N) bool
        Pair by pair, see `agreements`.
    relative : callable
        Keyframes a, b -> ``T_a_b`` and its covariance.
    config : LoopConfig, optional
    """
    c = config or LoopConfig()
    sure = np.array([d.verdict == "accepted" or d.reason != "ambiguous" for d in decisions], dtype=bool)
    members = _largest(agree, np.flatnonzero(sure))
    clique = set(members)
    if len({loops[k].query for k in members}) < c.min_clique:
        return tuple(decisions)
    others = [k for k in np.flatnonzero(sure).tolist() if k not in clique]
    rival = len(_largest(agree, np.array(others, dtype=np.int64))) if others else 0
    out = list(decisions)
    for k, (loop, decision) in enumerate(zip(loops, decisions, strict=True)):
        with_it = [m for m in members if m != k and agree[k, m]]
        fits = k in clique or len(with_it) == len(members)
        contradicted = not fits and 2 * len(with_it) < len(members) >= rival + c.min_clique
        if decision.verdict == "accepted" and decision.reason != "by-hand" and contradicted:
            numbers = {"agree": len(with_it), "loops": len(members)}
            out[k] = LoopDecision(verdict="revoked", reason="inconsistent", numbers=numbers)
        elif decision.verdict == "held":
            out[k] = _held(loop, [loops[m] for m in with_it], fits, len(members), rival, decision, relative, c)
    return tuple(out)


def _held(
    loop: LoopEvidence,
    supporters: Sequence[LoopEvidence],
    fits: bool,
    size: int,
    rival: int,
    decision: LoopDecision,
    relative: RelativePose,
    c: LoopConfig,
) -> LoopDecision:
    if not fits:
        against = {"agree": len(supporters), "loops": size}
        return LoopDecision(verdict="held", reason="inconsistent", numbers=against)
    if size < rival + c.min_clique:
        return LoopDecision(verdict="held", reason="rivals", numbers={"loops": size, "others": rival})
    queries, span = _sequence(loop, supporters, relative, c.window)
    needed = c.min_span * math.sqrt(max(float(np.linalg.eigvalsh(loop.odom_covariance[3:, 3:])[-1]), 0.0))
    numbers: dict[str, float] = {"clique": size, "sequence": queries, "span_m": span, "needed_span_m": needed}
    if queries < c.min_sequence or span < needed:
        reason = "ambiguous" if decision.reason == "ambiguous" else "alone"
        return LoopDecision(verdict="held", reason=reason, numbers=numbers)
    return LoopDecision(verdict="accepted", reason="clique", numbers=numbers)


def _sequence(
    loop: LoopEvidence, supporters: Sequence[LoopEvidence], relative: RelativePose, window: float
) -> tuple[int, float]:
    """Return how many other queries nearby support a loop, and the way between the outermost of them [m]."""
    offsets = {}
    for other in supporters:
        if other.query != loop.query and other.query not in offsets:
            first, last = sorted((loop.query, other.query))
            T: Array = relative(first, last)[0]
            distance = float(np.linalg.norm(T[:3, 3]))
            if distance <= window:
                offsets[other.query] = distance if other.query > loop.query else -distance
    ends = [0.0, *offsets.values()]
    return len(offsets), max(ends) - min(ends)


def _largest(agree: Mask, which: np.ndarray) -> tuple[int, ...]:
    found = maximum_clique(agree[np.ix_(which, which)])
    return tuple(int(which[k]) for k in found)
