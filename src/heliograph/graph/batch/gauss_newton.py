"""Gauss-Newton: full steps on the linearised problem, as long as they lower the cost."""

from __future__ import annotations

from heliograph.graph.batch.outcome import Minimum, Observer, Trace
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

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
    trace = Trace(observe)
    while len(trace.steps) < settings.max_iterations:
        key = problem.factorize(0.0, settings.damping_floor)
        if key is not None:
            return trace.minimum("indefinite", cost, key)
        predicted = problem.linear_step(0.0, settings.damping_floor)
        trial = problem.try_step()
        decrease = cost.cost - trial.cost
        small = max(settings.relative_decrease * cost.cost, settings.absolute_decrease)
        accepted = bool(decrease >= 0.0)
        if accepted:
            problem.accept()
            cost = trial
        trace.record(cost, accepted=accepted, gain_ratio=decrease / predicted if predicted > 0.0 else 0.0, damping=0.0)
        if abs(decrease) <= small or predicted <= small:
            return trace.minimum("converged", cost)
        if not accepted:
            return trace.minimum("diverged", cost)
        problem.linearize()
    return trace.minimum("max_iterations", cost)
