"""Registration of two clouds without a start: hypotheses refined, compared, and accepted or refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import AlignConfig, GlobalAlignConfig
from heliograph.lie import se3
from heliograph.registration.align_levels import METHODS, fit_levels, one_sided
from heliograph.registration.global_alignment import hypotheses
from heliograph.registration.surfaces import PreparedCloud

__all__ = ["GlobalStart", "find_start"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalStart:
    """The best pose found without a start, and whether its evidence suffices.

    Parameters
    ----------
    T : (4, 4) float64
        Source to target, between the clouds less their origins.
    accepted : bool
    reason : str
        Why not, in words.
    overlap : float
        The smaller of the two shares of elements with a counterpart.
    fit : float
        Evidence of the matches over the overlap, in [0, 1]: 1 where all of it fits to well below the kernel.
    lead : float
        Evidence over that of the best pose elsewhere; infinite where there is none.
    tried : int
        Hypotheses.
    """

    T: Array
    accepted: bool
    reason: str
    overlap: float
    fit: float
    lead: float
    tried: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scored:
    T: Array
    overlap: float
    evidence: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def fit(self) -> float:
        return self.evidence / self.overlap if self.overlap > 0.0 else 0.0


def find_start(
    target: PreparedCloud, source: PreparedCloud, config: AlignConfig, settings: GlobalAlignConfig, threads: int
) -> GlobalStart:
    """Try every hypothesis coarsely, refine those whose clouds overlap most, and judge the best by its evidence.

    Evidence is the robust weight of the matches in both directions, as a share of all elements. A pose is refused where
    too little overlaps, where what overlaps does not fit, and where a different pose explains the clouds nearly as
    well, as between like rooms.

    Parameters
    ----------
    target, source : PreparedCloud
    config : AlignConfig
    settings : GlobalAlignConfig
    threads : int
    """
    found = hypotheses(target, source, settings, threads)
    coarse = min(2, target.native.levels() - 1)
    reach = _edge(config, coarse)
    ranked = sorted(found, key=lambda h: -_smaller_overlap(target, source, h.T, coarse, reach, threads))
    scored = [_refined(target, source, h.T, config, settings, threads) for h in ranked[: settings.refined]]
    if not scored:
        return GlobalStart(T=np.eye(4), accepted=False, reason="no features of the clouds agree", overlap=0.0, fit=0.0,
                           lead=0.0, tried=0)  # fmt: skip
    scored.sort(key=lambda s: -s.evidence)
    best = scored[0]
    next_best = max((s.evidence for s in scored[1:] if _elsewhere(s.T, best.T, settings)), default=0.0)
    lead = best.evidence / next_best if next_best > 0.0 else float("inf")
    reason = _why_not(best, lead, settings)
    return GlobalStart(T=best.T, accepted=not reason, reason=reason, overlap=best.overlap, fit=best.fit, lead=lead,
                       tried=len(found))  # fmt: skip


def _why_not(best: _Scored, lead: float, settings: GlobalAlignConfig) -> str:
    if best.overlap < settings.min_overlap:
        return f"at the best pose {best.overlap:.0%} overlaps; needed is {settings.min_overlap:.0%}"
    if best.fit < settings.min_fit:
        return f"{best.fit:.0%} of the overlap fits the other cloud; needed is {settings.min_fit:.0%}"
    if lead < settings.min_lead:
        return (
            f"another pose has {1.0 / lead:.0%} of the best one's evidence; at most {1.0 / settings.min_lead:.0%} may"
        )
    return ""


def _refined(
    target: PreparedCloud,
    source: PreparedCloud,
    T: Array,
    config: AlignConfig,
    settings: GlobalAlignConfig,
    threads: int,
) -> _Scored:
    top = min(2, target.native.levels() - 1)
    T = fit_levels(target, source, T, "gicp", config, threads, levels=range(top, -1, -1)).T
    overlap = _smaller_overlap(target, source, T, 0, settings.reach, threads)
    there = _evidence(target, source, T, config, settings, threads)
    back = _evidence(source, target, np.ascontiguousarray(se3.inverse(T)), config, settings, threads)
    return _Scored(T=T, overlap=overlap, evidence=min(there, back))


def _evidence(
    target: PreparedCloud,
    source: PreparedCloud,
    T: Array,
    config: AlignConfig,
    settings: GlobalAlignConfig,
    threads: int,
) -> float:
    """Robust weight of the source's finest matches, over the number of its elements."""
    matcher = _core.Matcher(target.native, 0, source.native, 0)
    distribution, cosine, sided = METHODS["gicp"], config.min_cosine, one_sided(target, source)
    reach, kernel, sigma = settings.reach, settings.kernel, config.sigma
    sums = matcher.sums(T, distribution, False, reach, kernel, sigma, cosine, sided, False, threads)
    return float(sums[3]) / max(source.native.size(0), 1)


def _smaller_overlap(
    target: PreparedCloud, source: PreparedCloud, T: Array, level: int, reach: float, threads: int
) -> float:
    inverse = np.ascontiguousarray(se3.inverse(T))
    there = target.native.overlap(level, source.native, level, np.ascontiguousarray(T), reach, threads)
    return float(min(there, source.native.overlap(level, target.native, level, inverse, reach, threads)))


def _elsewhere(A: Array, B: Array, settings: GlobalAlignConfig) -> bool:
    d = se3.log(se3.inverse(A) @ B)
    turned = float(np.linalg.norm(d[:3])) > np.radians(settings.same_deg)
    return turned or float(np.linalg.norm(d[3:])) > settings.same


def _edge(config: AlignConfig, level: int) -> float:
    return config.voxel * 2.0**level if config.voxel > 0.0 else 1.0
