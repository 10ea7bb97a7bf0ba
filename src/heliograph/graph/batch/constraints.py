"""Hard constraints: residuals that must vanish, by the method of multipliers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from heliograph.graph.batch.outcome import Minimum, Observer
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["minimize_constrained", "stiffen"]


_TOLERANCE = 1e-10  # largest residual of a constraint that counts as none [m, rad]
_ROUNDS = 40
_PENALTY = 1e3  # of the typical information, to begin with
_STIFF = 1e8  # of the typical information: stands for a constraint where only its covariance matters


def minimize_constrained(
    minimize: Callable[[Problem, SolverSettings, Cost, Observer], Minimum],
    problem: Problem,
    settings: SolverSettings,
    observe: Observer,
) -> Minimum:
    """Minimise subject to ``r = 0`` for the constrained factors (Hestenes 1969, Powell 1969; docs/theory/graph.md).

    Parameters
    ----------
    minimize : callable
        Solves each round's unconstrained problem.
    problem : Problem
        Analysed; its values are moved.
    settings : SolverSettings
        Settings of each round.
    observe : callable
        Told of every iteration.

    Notes
    -----
    Each round minimises with the penalty ``mu |r + s|^2`` in place of a constraint; then ``s`` takes what is left of r,
    which makes ``mu s`` the multiplier. The penalty grows only where the constraint does not shrink fast enough, so the
    normal equations stay well conditioned, and the constraint holds to rounding at the end all the same.
    """
    groups = [index for index, group in enumerate(problem.groups) if group.constrained]
    penalty = _PENALTY * _typical_information(problem)
    shifts = [np.zeros(problem.groups[index].rows * len(problem.groups[index].variables)) for index in groups]
    steps: list[Minimum] = []
    before = np.inf
    violation = np.inf
    for _ in range(_ROUNDS):
        for index, shift in zip(groups, shifts, strict=True):
            problem.native.set_weights(index, np.full(len(problem.groups[index].variables), penalty))
            problem.native.set_shift(index, shift)
        steps.append(minimize(problem, settings, problem.linearize(), observe))
        if steps[-1].status == "indefinite":
            break
        residuals = [problem.native.residuals(index)[0].reshape(-1) for index in groups]
        violation = max(float(np.abs(r).max(initial=0.0)) for r in residuals)
        if violation <= _TOLERANCE:
            break
        shifts = [shift + r for shift, r in zip(shifts, residuals, strict=True)]
        if violation > 0.1 * before:
            penalty *= 10.0
            shifts = [shift / 10.0 for shift in shifts]
        before = violation
    return _summary(problem, groups, steps, violation)


def stiffen(problem: Problem) -> None:
    """Stand-in for constraints in a covariance: information far above everything else's."""
    groups = [index for index, group in enumerate(problem.groups) if group.constrained]
    if groups:
        problem.linearize()
        weight = _STIFF * _typical_information(problem)
        for index in groups:
            problem.native.set_weights(index, np.full(len(problem.groups[index].variables), weight))


def _typical_information(problem: Problem) -> float:
    """Return the median of the diagonal that the other factors make, 1 where there are none."""
    constrained = [index for index, group in enumerate(problem.groups) if group.constrained]
    for index in constrained:
        problem.native.set_weights(index, np.zeros(len(problem.groups[index].variables)))
    problem.linearize()
    problem.factorize(1.0, 1.0)
    diagonal = problem.native.diagonal()
    positive = diagonal[diagonal > 0.0]
    return float(np.median(positive)) if len(positive) else 1.0


def _summary(problem: Problem, groups: list[int], steps: list[Minimum], violation: float) -> Minimum:
    for index in groups:
        problem.native.set_weights(index, np.zeros(len(problem.groups[index].variables)))
    cost = problem.cost()
    status = steps[-1].status
    if status == "converged" and violation > _TOLERANCE:
        status = "stalled"
    iterations = [step for found in steps for step in found.iterations]
    numbered = tuple(replace(step, number=k + 1) for k, step in enumerate(iterations))
    return replace(steps[-1], status=status, iterations=numbered, chi2=cost.chi2, cost=cost.cost)
