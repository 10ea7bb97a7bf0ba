"""What `solve` returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from heliograph.graph.batch.outcome import Iteration
from heliograph.graph.diagnosis.diagnosis import Diagnosis
from heliograph.graph.model.values import Values

__all__ = ["POOR_COST", "Solution", "doubts"]

POOR_COST = 3.0  # a degree of freedom: honest noise gives about one at the optimum; above this the end is doubted


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A solved graph, and how it was solved.

    Parameters
    ----------
    values : Values
        The estimate.
    status : str
        ``converged``, ``max_iterations``, ``stalled`` (no step lowers the cost although the model says so),
        ``diverged`` (Gauss-Newton's cost rose).
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

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful about the estimate, and what may help; empty where nothing is."""
        return doubts(self.status, self.iterations, self.cost, self.degrees_of_freedom)


def doubts(status: str, iterations: int, cost: float, degrees_of_freedom: int) -> tuple[str, ...]:
    """Return what is doubtful about the end of a search, and what may help.

    Parameters
    ----------
    status : str
        As a solver says it.
    iterations : int
        Steps tried.
    cost : float
        At the end; robust where kernels are.
    degrees_of_freedom : int
        Rows less estimated scalars.
    """
    out = []
    if status != "converged":
        out.append(
            f"the solver ended as {status} after {iterations} iterations: chi2 may be above the optimum; give it more "
            "iterations, another start or another solver"
        )
    if degrees_of_freedom > 0 and cost > POOR_COST * degrees_of_freedom:
        out.append(
            f"the cost is {cost / degrees_of_freedom:.3g} a degree of freedom where honest noise gives about 1: the "
            "end is no optimum, some measurements are wrong, or their sigmas are too small"
        )
    return tuple(out)
