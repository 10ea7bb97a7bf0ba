"""What is known of a candidate loop, and what was decided about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.registration import ResidualDistribution

__all__ = ["REASONS", "LoopDecision", "LoopEvidence", "LoopStart", "RelativePose", "Verdict"]

Verdict: TypeAlias = Literal["accepted", "held", "rejected", "revoked"]

RelativePose: TypeAlias = Callable[[int, int], tuple[Array, Array]]
"""Keyframes a, b -> ``T_a_b`` (4, 4) of odometry and its covariance (6, 6), right perturbation at b."""

REASONS: Mapping[str, str] = {
    "clique": "enough loops agree with it and with each other",
    "by-hand": "added by hand",
    "no-pose": "registration found no pose",
    "odometry": "odometry's covariance excludes the pose",
    "twin": "odometry knows the way too badly to tell the place from one a storey or a corridor away",
    "overlap": "too little of the local maps overlaps",
    "fit": "what overlaps does not fit",
    "blind": "the match leaves directions unseen",
    "blur": "the map is less sharp with it than without",
    "ambiguous": "another pose that odometry allows fits nearly as well",
    "rivals": "another set of loops, which contradicts its own, is nearly as large",
    "alone": "too few loops of the same sequence agree with it yet",
    "inconsistent": "a larger set of loops contradicts it",
    "solve": "the graph's solution contradicts it",
    "revoked-by-hand": "revoked by hand",
}
"""Stable codes of decisions, with what they mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopStart:
    """Where a registration begins.

    Parameters
    ----------
    source : str
        Who says so: ``"odometry"``, ``"place"``, ``"hand"``.
    T_match_query : (4, 4) float64
        The query's body in the match's.
    """

    source: str
    T_match_query: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopEvidence:
    """Everything that a decision about one candidate needs; made once, kept with the ledger.

    Parameters
    ----------
    query, match : int
        Keyframes; the query is the later one.
    source : str
        Start of the registration that was kept.
    status : str
        Status of its `AlignResult`.
    T_match_query : (4, 4) float64
        The pose found; the start where there is none.
    covariance : (6, 6) float64
        Covariance of it, right perturbation (rotation, translation) [rad^2, m^2], with what local maps share.
    overlap_query, overlap_match : float
        Shares of the local maps that have a counterpart.
    inliers : float
        Share of the matches that fit their surface, within three sigma of the model.
    residuals : ResidualDistribution
    blind : tuple of str
        Directions that the match does not see.
    weakest : float
        Smallest eigenvalue of the information of the translation [1/m^2].
    T_match_query_odom : (4, 4) float64
        What odometry has in its place.
    odom_covariance : (6, 6) float64
        Covariance of that.
    odom_mahalanobis : float
        Squared distance of the two in both covariances: chi-square with six degrees of freedom if they agree.
    shift_level, shift_up : float
        How far the pose moves the query from where odometry has it, level and in height [m].
    doubt_level, doubt_up : float
        Odometry's one-sigma of the query there, along the worst level axis and in height [m].
    starts, agreeing : int
        Registrations made, and those that ended at this pose.
    lead : float
        Evidence over that of the best other pose that odometry allows; infinite where there is none.
    blur_before, blur_after : float
        Growth of the entropy by joining the local maps where odometry has them, and at the pose [nat]: 0 where
        walls fall onto walls; NaN where nothing falls together.
    score : float
        Likeness by the detector; NaN where none proposed it.
    """

    query: int
    match: int
    source: str
    status: str
    T_match_query: Array
    covariance: Array
    overlap_query: float
    overlap_match: float
    inliers: float
    residuals: ResidualDistribution
    blind: tuple[str, ...]
    weakest: float
    T_match_query_odom: Array
    odom_covariance: Array
    odom_mahalanobis: float
    starts: int
    agreeing: int
    lead: float
    shift_level: float = 0.0
    shift_up: float = 0.0
    doubt_level: float = 0.0
    doubt_up: float = 0.0
    blur_before: float = float("nan")
    blur_after: float = float("nan")
    score: float = float("nan")

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def overlap(self) -> float:
        """The smaller of the two overlaps."""
        return min(self.overlap_query, self.overlap_match)

    @property
    def disagreement(self) -> float:
        """Distance from odometry's pose [m]."""
        return float(np.linalg.norm(self.T_match_query[:3, 3] - self.T_match_query_odom[:3, 3]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopDecision:
    """What was decided, and why.

    Parameters
    ----------
    verdict : str
        ``"accepted"``, ``"held"`` (may still be accepted), ``"rejected"``, ``"revoked"`` (was accepted once).
    reason : str
        Key of `REASONS`.
    numbers : mapping of str to float
        What the reason compared.
    """

    verdict: Verdict
    reason: str
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The decision as a sentence with its numbers."""
        listed = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in self.numbers.items())
        return f"{self.verdict}: {REASONS[self.reason]}" + (f" ({listed})" if listed else "")
