"""Outliers found and left out: graduated non-convexity from a start that rests on what is trusted.

References
----------
.. [1] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception: from
   non-minimal solvers to global outlier rejection", RA-L 2020.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, Mask, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config_checks import check_choice, check_range
from heliograph.graph.batch.gnc_rounds import Rounds
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.outliers import trusted_factors
from heliograph.graph.model.values import Values

__all__ = ["RobustSettings", "RobustSolution", "solve_robust"]


_ENOUGH = 10  # accepted factors from which a scale can be told


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustSettings:
    """How outliers are told.

    Parameters
    ----------
    surrogate : str
        ``tls`` (truncated least squares) or ``gm`` (Geman-McClure).
    probability : float
        That a true factor's squared whitened residual is below the threshold: the chi-square quantile of its rows.
    scale_margin : float
        Where the residuals of accepted factors are much shorter than their noise says, the threshold shrinks to as many
        times their own scale (as a standard deviation); infinite: never. It never grows.
    step : float
        By which the convexity of the surrogate changes a round.
    steps_per_round : int
        Solver steps between two updates of the weights.
    max_rounds : int
        In each of the two stages.

    Raises
    ------
    ConfigError
        A value is out of its range.
    """

    surrogate: str = "tls"
    probability: float = 0.99
    scale_margin: float = 4.0
    step: float = 1.4
    steps_per_round: int = 2
    max_rounds: int = 100

    def __post_init__(self) -> None:
        check_choice(self, "surrogate", "tls", "gm")
        check_range(self, "probability", above=0.0, below=1.0)
        check_range(self, "scale_margin", above=0.0)
        check_range(self, "step", above=1.0)
        check_range(self, "steps_per_round", "max_rounds", low=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustSolution:
    """A graph solved without its outliers.

    Parameters
    ----------
    values : Values
        The estimate from trusted factors and inliers.
    status : str
        Status of the last solve: ``converged`` and so on.
    inliers : (N,) bool
        Factors that were used; the trusted ones always.
    weights : (N,) float64
        The last soft weights, 1 for trusted factors.
    squared : (N,) float64
        Squared whitened residuals at the estimate.
    threshold : (N,) float64
        That doubtful factors had to stay below.
    scale : float
        Standard deviation of accepted residuals in units of their noise, as the first stage found it.
    chi2 : float
        Sum of `squared` over the inliers.
    rounds, iterations : int
        Updates of the weights, and solver steps in all of them.
    start : str
        What the first stage rested on.
    """

    values: Values
    status: str
    inliers: Mask
    weights: Array
    squared: Array
    threshold: Array
    scale: float
    chi2: float
    rounds: int
    iterations: int
    start: str

    def __post_init__(self) -> None:
        freeze(self)


def solve_robust(
    graph: FactorGraph,
    values: Values,
    *,
    trusted: ArrayLike | None = None,
    settings: RobustSettings | None = None,
    threads: int = 1,
) -> RobustSolution:
    """Estimate the values and tell which factors are outliers (docs/theory/graph.md, eqs. 20-23).

    Graduated non-convexity needs an estimate near the truth to begin with, or a solver that needs none ([1]_ uses
    global ones). Here the trusted factors give one, in stages: the trusted factors alone; with them those doubtful
    relative poses that another one bears out, graduated from convex to the chosen surrogate; then every doubtful factor
    by Geman-McClure weights; last, hard inliers until they are the same twice.

    Parameters
    ----------
    graph : FactorGraph
        Robust kernels of doubtful factors are not used.
    values : Values
        One for every variable. Those that trusted factors determine are started from these factors.
    trusted : (K,) int or (N,) bool, optional
        Numbers of factors that are right, such as odometry and priors. Default: all but the between factors of keys
        that do not follow each other.
    settings : RobustSettings, optional
        Thresholds and schedule.
    threads : int
        For the native parts.

    Raises
    ------
    GraphError
        The graph does not fit the values, or a number in `trusted` is not a factor's.
    """
    settings = settings or RobustSettings()
    known = trusted_factors(graph, trusted)
    bound, median = row_quantiles(graph, settings.probability), row_quantiles(graph, 0.5)
    run = Rounds(graph, values, known, settings.steps_per_round, settings.max_rounds, threads)
    run.trusted_only()
    borne = run.borne_out(bound)
    run.graduate(settings.surrogate, borne if borne.any() else ~known, bound, settings.step)
    accepted = ~known & (run.squared <= bound) & (borne if borne.any() else True)
    scale = 1.0
    if accepted.sum() >= _ENOUGH:
        scale = float(np.sqrt(np.median(run.squared[accepted] / median[accepted])))
    threshold = bound * min(1.0, (settings.scale_margin * scale) ** 2)
    if borne.any() or threshold.sum() < bound.sum():
        run.graduate("gm", ~known, threshold, settings.step, begin=1.0)
    inliers, status = run.settle(threshold)
    return RobustSolution(
        values=run.values,
        status=status,
        inliers=inliers,
        weights=run.weights,
        squared=run.squared,
        threshold=threshold,
        scale=scale,
        chi2=float(run.squared[inliers].sum()),
        rounds=run.rounds,
        iterations=run.iterations,
        start=f"{int(known.sum())} trusted factors; {int(borne.sum())} of {int((~known).sum())} others borne out",
    )


def row_quantiles(graph: FactorGraph, probability: float) -> Array:
    """Return the chi-square quantile of every factor's rows, (N,)."""
    rows = np.concatenate([np.full(len(a.record), a.record.rows) for a in graph.groups()] or [np.zeros(0, np.int64)])
    kinds, which = np.unique(rows, return_inverse=True)
    return np.array([chi_square_quantile(probability, int(r)) for r in kinds], dtype=np.float64)[which]
