"""Gauss-Newton: full steps on the linearised problem, as long as they lower the cost."""

from __future__ import annotations

import numpy as np

from heliograph.graph.outcome import Iteration, Minimum, Observer
from heliograph.graph.problem import Cost, Problem
from heliograph.graph.settings import SolverSettings

__all__ = ["gauss_newton"]


def gauss_newton(problem: Problem, settings: SolverSettings, cost: Cost, observe: Observer) -> Minimum:
    """Minimise by Gauss-Newton (docs/theory/graph.md, eq. 7).

    Parameters
    ----------
    problem : Problem
        Analysed and linearised; its values are moved.
    settings : SolverSettings
        When to stop.
    cost : Cost
        At the problem's values.
    observe : callable
        Told of every iteration.

    Notes
    -----
    A step that raises the cost ends the search with the values before it: Gauss-Newton has no way to shorten it.
    """
    steps: list[Iteration] = []
    status = "max_iterations"
    while len(steps) < settings.max_iterations:
        key = problem.factorize(0.0, settings.damping_floor)
        if key is not None:
            return Minimum(status="indefinite", iterations=tuple(steps), chi2=cost.chi2, cost=cost.cost, indefinite_key=key)
        predicted = problem.linear_step(0.0, settings.damping_floor)
        trial = problem.try_step()
        decrease = cost.cost - trial.cost
        small = max(settings.relative_decrease * cost.cost, settings.absolute_decrease)
        accepted = bool(decrease >= 0.0)
        before, cost = cost, trial if accepted else cost
        ratio = decrease / predicted if predicted > 0.0 else np.nan
        steps.append(
            Iteration(number=len(steps) + 1, cost=cost.cost, chi2=cost.chi2, accepted=accepted, gain_ratio=ratio, damping=0.0)
        )
        observe(steps[-1])
        if accepted:
            problem.accept()
        if abs(decrease) <= small or predicted <= small * 1e-3:
            status = "converged"
            break
        if not accepted:
            status = "diverged"
            break
        del before
        problem.linearize()
    return Minimum(status=status, iterations=tuple(steps), chi2=cost.chi2, cost=cost.cost)
