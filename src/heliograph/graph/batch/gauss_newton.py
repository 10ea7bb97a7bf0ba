"""Gauss-Newton: full steps on the linearised problem, over a ridge too if it is a low one."""

from __future__ import annotations

from heliograph.graph.batch.outcome import Minimum, Observer, Trace
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["gauss_newton"]

_RISES = 3  # steps in a row from the lowest cost that may stay above it
_RIDGE = 100.0  # times the lowest cost: higher up there is no way back


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
        Given every iteration.

    Notes
    -----
    Gauss-Newton has no way to shorten a step. One that raises the cost is taken all the same unless it leads far up,
    for the next ones often lead down again; where they do not, the search has diverged, and ends where it was lowest.
    """
    trace, lowest, above = Trace(observe), cost, 0
    best = None  # the values of the lowest cost, while the search is above it
    while len(trace.steps) < settings.max_iterations:
        key = problem.factorize(0.0, settings.damping_floor)
        if key is not None:
            if best is None:
                return trace.minimum("indefinite", cost, key)
            break
        predicted = problem.linear_step(0.0, settings.damping_floor)
        trial = problem.try_step()
        decrease = cost.cost - trial.cost
        small = max(settings.relative_decrease * cost.cost, settings.absolute_decrease)
        ended = abs(decrease) <= small or predicted <= small
        above = 0 if trial.cost <= lowest.cost else above + 1
        accepted = decrease >= 0.0 or (not ended and above <= _RISES and trial.cost <= _RIDGE * lowest.cost)
        gain = decrease / predicted if predicted > 0.0 else 0.0
        if accepted:
            best = None if above == 0 else problem.native.values() if best is None else best
            problem.accept()
            cost = trial
            lowest = cost if above == 0 else lowest
        trace.record(cost, accepted=bool(accepted), gain_ratio=gain, damping=0.0)
        if ended and best is None:
            return trace.minimum("converged", cost)
        if ended or not accepted or above > _RISES:
            break
        problem.linearize()
    else:
        if best is None:
            return trace.minimum("max_iterations", cost)
    if best is not None:
        problem.native.set_values(best)
    return trace.minimum("diverged", lowest)
