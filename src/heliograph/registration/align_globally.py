"""Registration of two clouds without a start: hypotheses refined, compared, and accepted or refused."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze
from heliograph.config import AlignConfig, GlobalAlignConfig
from heliograph.lie import se3
from heliograph.registration.align_levels import METHODS, fit_levels, level_matches, one_sided
from heliograph.registration.global_alignment import hypotheses
from heliograph.registration.global_evidence import HELD, GlobalEvidence, log_odds
from heliograph.registration.surfaces import PreparedCloud

__all__ = ["GlobalStart", "find_start"]

Array = NDArray[np.float64]
_SLIDES = (-2.25, -1.5, -0.75, 0.75, 1.5, 2.25)  # places that are tried along a translation that little holds [m]
_THROUGH = 10.0  # a share of this one over of what should be seen, seen through, takes a pose's score to 1/e


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
    evidence : GlobalEvidence or None
        None where no features agree.
    tried : int
        Hypotheses.
    """

    T: Array
    accepted: bool
    reason: str
    evidence: GlobalEvidence | None
    tried: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scored:
    T: Array
    overlap: float
    confirmed: float
    seen_through: float
    weight: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def score(self) -> float:
        """What fits, as far as the scans do not contradict it."""
        return self.weight * self.confirmed**2 * math.exp(-_THROUGH * self.seen_through)


class _Pair:
    """Two clouds, what each saw by direction, and the settings."""

    def __init__(
        self,
        target: PreparedCloud,
        source: PreparedCloud,
        config: AlignConfig,
        settings: GlobalAlignConfig,
        threads: int,
    ) -> None:
        self.target, self.source, self.config, self.settings, self.threads = target, source, config, settings, threads
        self.sided = one_sided(target, source)
        cell = np.radians(settings.cell_deg)
        clouds = (target, source) if self.sided else ()
        self.images = [_core.RangeImage(cloud.points, cell) for cloud in clouds]

    def sights(self, T: Array, level: int, reach: float) -> tuple[float, float, float]:
        """Return overlap, share confirmed and share seen through at a pose, each of the worse direction."""
        back = np.ascontiguousarray(se3.inverse(T))
        ways = ((self.target, self.source, np.ascontiguousarray(T)), (self.source, self.target, back))
        if not self.images:  # clouds without a viewpoint: all of one should be in the other
            overlap = min(
                to.native.overlap(level, some.native, level, pose, reach, self.threads) for to, some, pose in ways
            )
            return overlap, overlap, 0.0
        shares = []
        for image, (to, some, pose) in zip(self.images, ways, strict=True):
            near, expected, through = image.sight(to.native, some.native, level, pose, reach, self.threads)
            shares.append((near / max(some.native.size(level), 1), near / max(expected, 1), through / max(expected, 1)))
        overlap, confirmed = (min(share[k] for share in shares) for k in range(2))
        return overlap, confirmed, max(share[2] for share in shares)

    def refined(self, T: Array, *, top: int = 2) -> _Scored:
        """Align from a hypothesis and look at what comes of it."""
        levels = range(min(top, self.target.native.levels() - 1), -1, -1)
        T = fit_levels(self.target, self.source, T, "gicp", self.config, self.threads, levels=levels).T
        overlap, confirmed, through = self.sights(T, 0, self.settings.reach)
        there = self._weight(self.target, self.source, T)
        back = self._weight(self.source, self.target, np.ascontiguousarray(se3.inverse(T)))
        return _Scored(T=T, overlap=overlap, confirmed=confirmed, seen_through=through, weight=min(there, back))

    def _weight(self, target: PreparedCloud, source: PreparedCloud, T: Array) -> float:
        """Robust weight of the source's finest matches, over the number of its elements."""
        matcher = _core.Matcher(target.native, 0, source.native, 0)
        reach, kernel = self.settings.reach, self.settings.kernel
        sums = matcher.sums(T, METHODS["gicp"], False, reach, kernel, self.config.sigma, self.config.min_cosine,
                            self.sided, False, self.threads)  # fmt: skip
        return float(sums[3]) / max(source.native.size(0), 1)

    def weakest(self, T: Array) -> tuple[float, Array]:
        """Return the share of the plane matches' weight that holds the translation held least, and its axis."""
        level = min(1, self.target.native.levels() - 1)
        rows = level_matches(
            self.target, self.source, T, "point-to-plane", level, self.settings.kernel, self.config, self.threads
        )
        if len(rows) < self.config.min_matches:
            return 0.0, np.array([1.0, 0.0, 0.0])
        n, w = rows[:, 3:6], rows[:, 8]
        values, vectors = np.linalg.eigh((n * w[:, None]).T @ n)
        return float(values[0] / max(float(w.sum()), 1e-12)), np.asarray(vectors[:, 0])

    def slides(self, best: _Scored) -> list[_Scored]:
        """Align from places along the translation that a pose holds least: a bare wall has its like next to it."""
        share, axis = self.weakest(best.T)
        if share >= HELD:
            return []
        found: list[_Scored] = []
        for step in _SLIDES:
            T = best.T.copy()
            T[:3, 3] += T[:3, :3] @ (step * axis)
            some = self.refined(T, top=1)
            if all(_elsewhere(some.T, s.T, self.settings) for s in (best, *found)):
                found.append(some)
        return found


def find_start(
    target: PreparedCloud, source: PreparedCloud, config: AlignConfig, settings: GlobalAlignConfig, threads: int
) -> GlobalStart:
    """Try every hypothesis coarsely, refine the best, and judge the best of those by its evidence.

    Parameters
    ----------
    target, source : PreparedCloud
    config : AlignConfig
    settings : GlobalAlignConfig
    threads : int
        The result does not depend on it.
    """
    found = hypotheses(target, source, settings, threads)
    if not found:
        return GlobalStart(T=np.eye(4), accepted=False, reason="no features of the clouds agree", evidence=None,
                           tried=0)  # fmt: skip
    pair = _Pair(target, source, config, settings, threads)
    coarse = min(2, target.native.levels() - 1)
    reach = _edge(config, coarse)

    def promise(T: Array) -> float:
        overlap, confirmed, through = pair.sights(T, coarse, reach)
        return overlap * confirmed**2 * math.exp(-_THROUGH * through)

    scored: list[_Scored] = []
    for h in sorted(found, key=lambda h: -promise(h.T)):
        if all(_elsewhere(h.T, s.T, settings) for s in scored):  # else it would only end there again
            scored.append(pair.refined(h.T))
        if len(scored) == settings.refined:
            break
    scored += pair.slides(max(scored, key=lambda s: s.score))
    scored.sort(key=lambda s: -s.score)
    evidence = _evidence(pair, scored, settings)
    reason = _why_not(evidence, settings)
    return GlobalStart(T=scored[0].T, accepted=not reason, reason=reason, evidence=evidence, tried=len(found))


def _evidence(pair: _Pair, scored: list[_Scored], settings: GlobalAlignConfig) -> GlobalEvidence:
    best = scored[0]
    next_best = max((s.score for s in scored[1:] if _elsewhere(s.T, best.T, settings)), default=0.0)
    return GlobalEvidence(
        overlap=best.overlap,
        fit=best.weight / best.overlap if best.overlap > 0.0 else 0.0,
        confirmed=best.confirmed,
        seen_through=best.seen_through,
        lead=best.score / next_best if next_best > 0.0 else float("inf"),
        weakest=pair.weakest(best.T)[0],
        elements=min(pair.target.native.size(0), pair.source.native.size(0)),
    )


def _why_not(evidence: GlobalEvidence, settings: GlobalAlignConfig) -> str:
    e, odds = evidence, log_odds(evidence)
    if odds >= math.log(settings.min_odds):
        return ""
    return (
        f"the best pose has odds of {math.exp(min(odds, 700.0)):.3g}, needed are {settings.min_odds:g}: "
        f"{e.overlap:.0%} overlaps, {e.fit:.0%} of that fits, {e.confirmed:.0%} of what should be seen is, "
        f"{e.seen_through:.1%} is seen through, and a pose elsewhere has {1.0 / e.lead:.0%} of its score"
    )


def _elsewhere(A: Array, B: Array, settings: GlobalAlignConfig) -> bool:
    d = se3.log(se3.inverse(A) @ B)
    turned = float(np.linalg.norm(d[:3])) > np.radians(settings.same_deg)
    return turned or float(np.linalg.norm(d[3:])) > settings.same


def _edge(config: AlignConfig, level: int) -> float:
    return config.voxel * 2.0**level if config.voxel > 0.0 else 1.0
