"""What speaks for a pose that was found without a start, and how likely it is right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import freeze

__all__ = ["HELD", "GlobalEvidence", "features", "log_odds"]

_LEAST = 1e-3
_LEAD = 0.3  # of a score's logarithm: what leads by more leads
_TWIN = 30.0  # observations that count as independent where the scores of two poses are compared
HELD = 0.02  # share of the weight: a translation that is held by more is held


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalEvidence:
    """Evidence for one pose of two clouds; shares are of the worse of the two directions.

    Parameters
    ----------
    overlap : float
        Share of a cloud's elements with a counterpart in the other, in [0, 1].
    fit : float
        Robust weight of the matches over the overlap: 1 where all of it fits to well below the kernel.
    confirmed : float
        Share with a counterpart among the elements that the other scan should see: it looked there, and nothing it saw
        hides them.
    seen_through : float
        Share of the same that the other scan looked through, at something behind.
    lead : float
        Score over that of the best pose elsewhere; infinite where there is none.
    weakest : float
        Share of the matches' weight that holds the translation that is held least, in [0, 1/3].
    elements : int
        Number in the smaller cloud.
    """

    overlap: float
    fit: float
    confirmed: float
    seen_through: float
    lead: float
    weakest: float
    elements: int

    def __post_init__(self) -> None:
        freeze(self)


def features(evidence: GlobalEvidence) -> tuple[float, ...]:
    """Return the terms that `log_odds` weighs."""
    e = evidence
    return (
        math.log(max(e.overlap, _LEAST)),
        math.log(max(e.fit, _LEAST)),
        math.log(max(e.confirmed, _LEAST)),
        -math.sqrt(e.seen_through),
        min(math.log(max(e.lead, 1.0)), _LEAD),
        math.log(min(max(e.weakest, _LEAST), HELD)),
    )


# By `python -m benchmarks.global_evidence_fit`: 303 answers of simulated places and of hku_1.
_WEIGHTS = np.array([2.446, 1.951, 2.483, 30.453, 7.708, 0.339])
_OFFSET = 8.438


def log_odds(evidence: GlobalEvidence) -> float:
    """Return the logarithm of the odds that a pose is right.

    The odds against it are those by its own evidence, and those for the pose elsewhere whose score comes next: where
    two poses explain the clouds alike, neither is likelier than the other, whatever it explains.

    Parameters
    ----------
    evidence : GlobalEvidence
    """
    own = float(_OFFSET + np.dot(_WEIGHTS, features(evidence)))
    return -float(np.logaddexp(-own, -_TWIN * math.log(max(evidence.lead, 1.0))))
