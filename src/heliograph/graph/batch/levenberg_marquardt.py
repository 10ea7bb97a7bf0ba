"""Levenberg-Marquardt: Gauss-Newton with a damping that the true cost's gain ratio steers."""

from __future__ import annotations

from dataclasses import replace

from heliograph.graph.batch.dogleg import dogleg
from heliograph.graph.batch.outcome import Iteration, Minimum, Observer, Trace
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["levenberg_marquardt"]

_LEAST_GAIN = 1e-4  # of the predicted decrease: less is no progress
_UNDAMPED = 1e-2  # up to this damping a small step makes it worth asking what the full one promises
_FULL = 1e-10  # up to this damping a step is the full one: the weakest directions of long chains are little stiffer
_HOLD = 1e-6  # the damping from which rejections go up
_SHRINK = 0.1  # of the damping, at most, after a good step
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
    Nielsen's (1999). The gain ratio divides the decrease of the true robust cost by that of the quadratic model. A step
    that was damped may be small for that alone: where the undamped one still promises much, the dogleg goes on, which
    shortens that step instead of bending it away from a narrow valley.
    """
    trace = Trace(observe)
    damping, growth, promised = settings.initial_damping, _GROWTH, 0.0
    while len(trace.steps) < settings.max_iterations:
        used, decrease, predicted = damping, 0.0, 0.0
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
            damping = max(damping * max(_SHRINK, 1.0 - (2.0 * gain - 1.0) ** 3), settings.damping_floor)
            growth = _GROWTH
        else:
            damping, growth = max(damping, settings.initial_damping, _HOLD) * growth, _GROWTH * growth
        promised = 0.0 if accepted else max(promised, predicted)  # by the boldest of the steps rejected since
        trace.record(cost, accepted=accepted, gain_ratio=gain, damping=used)
        if key is None and used <= _UNDAMPED and (decrease if accepted else predicted) <= small:
            if used <= _FULL or not accepted or _full_promise(problem, settings) <= small:
                return trace.minimum("converged", cost)
            return _finished(trace, problem, settings, cost, observe)
        if damping > settings.max_damping:
            if key is not None:
                return trace.minimum("indefinite", cost, key)
            return trace.minimum("converged" if promised <= small else "stalled", cost)
        if accepted:
            problem.linearize()
    return trace.minimum("max_iterations", cost)


def _finished(trace: Trace, problem: Problem, settings: SolverSettings, cost: Cost, observe: Observer) -> Minimum:
    """Go on by the dogleg with the iterations that are left."""
    done = len(trace.steps)

    def go_on(step: Iteration) -> None:
        observe(replace(step, number=step.number + done))

    rest = dogleg(problem, replace(settings, max_iterations=settings.max_iterations - done), cost, go_on)
    numbered = [replace(step, number=step.number + done) for step in rest.iterations]
    return replace(rest, iterations=(*trace.steps, *numbered))


def _full_promise(problem: Problem, settings: SolverSettings) -> float:
    """Linearise, and return by how much the undamped model says that the cost still falls."""
    problem.linearize()
    if problem.factorize(0.0, settings.damping_floor) is not None:
        return float("inf")
    return problem.linear_step(0.0, settings.damping_floor)
