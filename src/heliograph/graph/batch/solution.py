"""What `solve` returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from heliograph.graph.batch.outcome import Iteration
from heliograph.graph.diagnosis.diagnosis import Diagnosis
from heliograph.graph.model.values import Values

__all__ = ["Solution"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A solved graph, and how it was solved.

    Parameters
    ----------
    values : Values
        The estimate.
    status : str
        ``converged``, ``max_iterations``, ``stalled``, ``diverged``.
    iterations : int
        Steps tried.
    initial_chi2, chi2 : float
        Sum of squared whitened residuals at the values that were given and at the estimate: no kernel, no factor 1/2.
    initial_cost, cost : float
        What is minimised, ``sum 2 rho(|r|)``; equal to chi2 without kernels.
    rows, degrees_of_freedom : int
        Numbers in the residuals; rows less estimated scalars, what chi2 is expected to be of honest noise.
    start : str
        Which start was used and why.
    steps : tuple of Iteration
        Every step.
    seconds : mapping of str to float
        By stage: ``order`` (ordering, symbolic work), ``start`` (chordal), ``diagnose``, ``iterate``; ``total``
        is their sum.
    diagnosis : Diagnosis
        Its `free` names what only factors held that their robust kernels reject altogether at the estimate; such
        variables stay about where they started. Everything else is determined, or `solve` would have raised.
    plan : mapping
        Facts of the elimination: fronts, doubles of the factor, multiplications.
    """

    values: Values
    status: str
    iterations: int
    initial_chi2: float
    chi2: float
    initial_cost: float
    cost: float
    rows: int
    degrees_of_freedom: int
    start: str
    steps: tuple[Iteration, ...]
    seconds: Mapping[str, float]
    diagnosis: Diagnosis
    plan: Mapping[str, Any]
