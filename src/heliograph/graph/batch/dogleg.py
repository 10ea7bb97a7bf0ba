"""Powell's dogleg: between steepest descent and Gauss-Newton, inside a region where the model is trusted."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.graph.batch.outcome import Minimum, Observer, Trace
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["dogleg"]


_LEAST_GAIN = 1e-4  # of the predicted decrease: less is no progress
_LEAST_RADIUS = 1e-12  # of the Gauss-Newton step: below it nothing can be won
_NEARLY_FULL = 1e-8  # damping up to which the Gauss-Newton step counts as one
_UNKEPT = 10.0  # times what a small step won: if the model promised more, its end is none
_POOR, _GOOD = 0.25, 0.75  # gain ratios below and above which the region shrinks and grows


def dogleg(problem: Problem, settings: SolverSettings, cost: Cost, observe: Observer) -> Minimum:
    """Minimise by Powell's dogleg (docs/theory/graph.md, eqs. 11-12); the cost never rises.

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
    Lengths are taken with the diagonal D of the normal equations, ``|p|^2 = p' D p``, so that units do not matter. A
    rejected step costs no factorisation. Where the normal equations are singular, the least damping that makes them
    factorise defines the Gauss-Newton step.
    """
    trace = Trace(observe)
    radius, model, damping = np.inf, None, 0.0
    while len(trace.steps) < settings.max_iterations:
        if model is None:
            damping, key = _factorize(problem, settings)
            if key is not None:
                return trace.minimum("indefinite", cost, key)
            model = _Model(problem)
        step, length = model.step(radius)
        predicted = model.decrease(step)
        small = max(settings.relative_decrease * cost.cost, settings.absolute_decrease)
        problem.native.set_step(step)
        trial = problem.try_step()
        decrease = cost.cost - trial.cost
        gain = decrease / predicted if predicted > 0.0 else -1.0
        accepted = gain > _LEAST_GAIN
        if accepted:
            problem.accept()
            cost = trial
        trace.record(cost, accepted=accepted, gain_ratio=gain, damping=length)
        full = length >= model.newton_length
        if full and (decrease if accepted else predicted) <= small and predicted <= _UNKEPT * small:
            return trace.minimum("converged" if damping <= _NEARLY_FULL else "stalled", cost)
        if not gain >= _POOR:
            radius = 0.25 * length
        elif gain > _GOOD:
            radius = max(radius, 3.0 * length)
        if accepted:
            problem.linearize()
            model = None
        elif radius < _LEAST_RADIUS * model.newton_length:
            return trace.minimum("stalled", cost)
    return trace.minimum("max_iterations", cost)


def _factorize(problem: Problem, settings: SolverSettings) -> tuple[float, int | None]:
    """Factorise with the least damping that works and solve for the Gauss-Newton step; return it, or where it fails."""
    damping = 0.0
    while True:
        key = problem.factorize(damping, settings.damping_floor)
        if key is None:
            problem.linear_step(damping, settings.damping_floor)
            return damping, None
        damping = max(10.0 * damping, 1e-10)
        if damping > 1.0:
            return damping, key


def _dot(a: Array, b: Array) -> float:
    return float(np.einsum("i,i->", a, b))  # not BLAS: it would use threads of its own


class _Model:
    """The quadratic model at the present values, with its steepest-descent and Gauss-Newton steps."""

    def __init__(self, problem: Problem) -> None:
        self._multiply = problem.native.multiply
        self.g = problem.native.gradient()
        self.D = np.maximum(problem.native.diagonal(), np.finfo(float).tiny)
        self.newton = problem.native.step()
        self.newton_length = self._length(self.newton)
        direction = -self.g / self.D
        curvature = _dot(direction, self._multiply(direction))
        slope = _dot(self.g, direction)
        self.cauchy = direction * (-slope / curvature) if curvature > 0.0 else direction

    def _length(self, p: Array) -> float:
        return float(np.sqrt(np.sum(self.D * p * p)))

    def step(self, radius: float) -> tuple[Array, float]:
        """Return the dogleg's step within the radius, and its length."""
        if self.newton_length <= radius:
            return self.newton, self.newton_length
        cauchy_length = self._length(self.cauchy)
        if cauchy_length >= radius:
            return self.cauchy * (radius / cauchy_length), radius
        leg = self.newton - self.cauchy
        a, b = float(np.sum(self.D * leg * leg)), float(np.sum(self.D * self.cauchy * leg))
        c = cauchy_length**2 - radius**2
        share = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a if b <= 0.0 else -c / (b + np.sqrt(b * b - a * c))
        return self.cauchy + share * leg, radius

    def decrease(self, p: Array) -> float:
        """Return by how much the model says that the cost falls along p: ``-2 g'p - p'H p``."""
        return -2.0 * _dot(self.g, p) - _dot(p, self._multiply(p))
