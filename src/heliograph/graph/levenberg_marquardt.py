"""Levenberg-Marquardt: Gauss-Newton with a damping that the true cost's gain ratio steers."""

from __future__ import annotations

from heliograph.graph.outcome import Iteration, Minimum, Observer
from heliograph.graph.problem import Cost, Problem
from heliograph.graph.settings import SolverSettings

__all__ = ["levenberg_marquardt"]

_LEAST_GAIN = 1e-4  # of the predicted decrease: less is no progress
_UNDAMPED = 1e-2  # up to this damping a step counts as a full one
_GROWTH = 4.0  # of the damping after a rejection, and of itself after each further one


def levenberg_marquardt(problem: Problem, settings: SolverSettings, cost: Cost, observe: Observer) -> Minimum:
    """Minimise by Levenberg-Marquardt (docs/theory/graph.md, eqs. 8-10); the cost never rises.

    Parameters
    ----------
    problem : Problem
        Analysed and linearised; its values are moved.
    settings : SolverSettings
        When to stop, and the damping.
    cost : Cost
        At the problem's values.
    observe : callable
        Told of every iteration.

    Notes
    -----
    Marquardt's scaling: the damping is relative to the diagonal, so units do not matter. The update of the damping is
    Nielsen's (1999). The gain ratio divides the decrease of the true robust cost by that of the quadratic model.
    """
    steps: list[Iteration] = []
    damping, growth = settings.initial_damping, _GROWTH
    status = "max_iterations"
    while len(steps) < settings.max_iterations:
        used, decrease, predicted = damping, -1.0, 0.0
        small = max(settings.relative_decrease * cost.cost, settings.absolute_decrease)
        key = problem.factorize(damping, settings.damping_floor)
        if key is None:
            predicted = problem.linear_step(damping, settings.damping_floor)
            trial = problem.try_step()
            decrease = cost.cost - trial.cost
        gain = decrease / predicted if predicted > 0.0 else -1.0
        accepted = gain > _LEAST_GAIN
        if accepted:
            problem.accept()
            cost = trial
            damping = max(damping * max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-15)
            growth = _GROWTH
        else:
            damping, growth = max(damping, 1e-6) * growth, _GROWTH * growth
        steps.append(
            Iteration(
                number=len(steps) + 1, cost=cost.cost, chi2=cost.chi2, accepted=accepted, gain_ratio=gain, damping=used
            )
        )
        observe(steps[-1])
        if key is None and used <= _UNDAMPED and (predicted <= small if not accepted else decrease <= small):
            status = "converged"
            break
        if damping > settings.max_damping:
            if key is not None:
                return Minimum(
                    status="indefinite", iterations=tuple(steps), chi2=cost.chi2, cost=cost.cost, indefinite_key=key
                )
            status = "stalled" if predicted > small else "converged"
            break
        if accepted:
            problem.linearize()
    return Minimum(status=status, iterations=tuple(steps), chi2=cost.chi2, cost=cost.cost)
