"""What a registration of two clouds answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.registration.blind_directions import InformationAnalysis

__all__ = ["AlignResult", "ResidualDistribution"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDistribution:
    """Residuals of the final matches, as lengths [m].

    Parameters
    ----------
    rms, median, p90, p99, max : float
        Root mean square and quantiles; NaN without matches.
    reduced_chi_square : float
        Mean of the squared residuals over their variances, robustly weighted: 1 where the noise is as modelled.
    """

    rms: float
    median: float
    p90: float
    p99: float
    max: float
    reduced_chi_square: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignResult:
    """The pose of one cloud in another's frame, and how far to trust it.

    Parameters
    ----------
    status : str
        ``"converged"``; ``"not converged"``: the last step was larger than the tolerance; ``"degenerate"``: converged,
        but the directions in ``observability.blind`` keep their start; ``"no overlap"``: there is no answer;
        ``"refused"``: a global search found no pose that its evidence supports; `start` is the best it found.
    method : str
        The residual.
    T_target_source : (4, 4) float64 or None
        The pose; None where there is no answer.
    covariance : (6, 6) float64 or None
        Covariance of the pose, right perturbation (rotation, translation) [rad^2, m^2]; blind directions have the
        start's.
    information : (6, 6) float64 or None
        Information of the matches alone: blind directions included as they are.
    start : (4, 4) float64
        What it began from.
    iterations : int
        On all levels together.
    elements, matches, inliers : int
        Elements of the source, those with a partner, and those whose residual is within three sigma of its model.
    overlap_source, overlap_target : float
        Shares of the source's and of the target's elements that have a counterpart at the pose.
    residuals : ResidualDistribution
    observability : InformationAnalysis or None
        Eigenvalues and the directions that are not seen; of the surfaces, whatever residual was minimised.
    seconds : mapping of str to float
        ``"prepare"``, ``"start"``, ``"iterate"``, ``"judge"``.
    reason : str
        In words, where the status is not ``"converged"``.
    """

    status: str
    method: str
    T_target_source: Array | None
    covariance: Array | None
    information: Array | None
    start: Array
    iterations: int
    elements: int
    matches: int
    inliers: int
    overlap_source: float
    overlap_target: float
    residuals: ResidualDistribution
    observability: InformationAnalysis | None
    seconds: Mapping[str, float]
    reason: str = ""

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def converged(self) -> bool:
        """Whether there is a pose that the matches settle, but for named blind directions."""
        return self.status in ("converged", "degenerate")

    def as_dict(self) -> dict[str, object]:
        """Return the result as plain numbers and lists, for JSON."""
        blind = () if self.observability is None else self.observability.blind
        return {
            "status": self.status,
            "reason": self.reason,
            "method": self.method,
            "T_target_source": _rows(self.T_target_source),
            "covariance": _rows(self.covariance),
            "iterations": self.iterations,
            "elements": self.elements,
            "matches": self.matches,
            "inliers": self.inliers,
            "overlap_source": self.overlap_source,
            "overlap_target": self.overlap_target,
            "residuals": {name: getattr(self.residuals, name) for name in ResidualDistribution.__slots__},
            "blind": [
                {"kind": d.kind, "direction_source": d.direction.tolist(), "probability": d.probability} for d in blind
            ],
            "eigenvalues": None
            if self.observability is None
            else {
                "rotation": [d.information for d in self.observability.rotation],
                "translation": [d.information for d in self.observability.translation],
            },
            "seconds": dict(self.seconds),
        }


def _rows(matrix: Array | None) -> list[list[float]] | None:
    return None if matrix is None else [[float(x) for x in row] for row in matrix]
