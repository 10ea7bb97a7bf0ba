"""What speaks for a pose that was found without a start, and how likely it is right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import freeze

__all__ = ["GlobalEvidence", "log_odds"]

_LEAST = 1e-3
_LEAD = 0.3  # of a score's logarithm: what leads by more leads


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
        Of the smaller cloud.
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
        math.log(max(e.weakest, _LEAST)),
    )


_WEIGHTS = np.zeros(6)
_OFFSET = 0.0


def log_odds(evidence: GlobalEvidence) -> float:
    """Return the logarithm of the odds that a pose is right.

    Parameters
    ----------
    evidence : GlobalEvidence
    """
    return float(_OFFSET + np.dot(_WEIGHTS, features(evidence)))
