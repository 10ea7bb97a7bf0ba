"""Batch estimation: the values that a graph of factors makes most likely."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

from heliograph.errors import ConfigError, GraphError, closest
from heliograph.graph.batch.constraints import minimize_constrained
from heliograph.graph.batch.dogleg import dogleg
from heliograph.graph.batch.gauss_newton import gauss_newton
from heliograph.graph.batch.initial import Start, choose_start, second_start
from heliograph.graph.batch.levenberg_marquardt import levenberg_marquardt
from heliograph.graph.batch.outcome import Iteration, Minimum, Observer
from heliograph.graph.batch.solution import Solution
from heliograph.graph.diagnosis.diagnosis import Diagnosis, require_determined, require_solved
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.values import Values
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["METHODS", "solve"]

Minimizer: TypeAlias = Callable[[Problem, SolverSettings, Cost, Observer], Minimum]
METHODS: dict[str, Minimizer] = {"gn": gauss_newton, "lm": levenberg_marquardt, "dogleg": dogleg}
STARTS = ("auto", "given", "chordal")


def solve(
    graph: FactorGraph,
    values: Values,
    method: str = "lm",
    *,
    initial: str = "auto",
    settings: SolverSettings | None = None,
    threads: int = 1,
    observer: Observer | None = None,
) -> Solution:
    """Minimise the sum of squared (robust) residuals from a given or a chordal start; see `heliograph.graph.solve`.

    Without anything to estimate the values come back as they are.
    """
    _check(method, initial)
    problem = Problem(graph, values, threads=threads)
    if not len(values):
        raise GraphError("the graph leaves nothing to estimate: it has no variables")
    if problem.free_scalars == 0:
        return _nothing(problem)
    run = _Run(METHODS[method], settings or SolverSettings(), observer or _ignore, _Clock())
    problem.analyze(run.settings.ordering)
    run.clock.lap("order")
    first = problem.linearize()
    problem.check_finite(first)
    run.clock.lap("iterate")
    before = require_determined(problem)
    run.clock.lap("diagnose")
    start, found, steps = _search(problem, values, initial, first, run)
    diagnosis = require_solved(problem, before=before, failed=found.status == "indefinite")
    run.clock.lap("diagnose")
    return Solution(
        values=problem.values(),
        status=found.status,
        iterations=len(steps),
        initial_chi2=first.chi2,
        chi2=found.chi2,
        initial_cost=first.cost,
        cost=found.cost,
        rows=problem.rows,
        degrees_of_freedom=problem.rows - problem.free_scalars,
        start=start.text,
        steps=steps,
        seconds=run.clock.seconds(),
        diagnosis=diagnosis,
        plan=problem.native.plan(),
    )


def _nothing(problem: Problem) -> Solution:
    """Return the values as they are, all of them held."""
    cost = problem.cost()
    problem.check_finite(cost)
    return Solution(
        values=problem.values(),
        status="converged",
        iterations=0,
        initial_chi2=cost.chi2,
        chi2=cost.chi2,
        initial_cost=cost.cost,
        cost=cost.cost,
        rows=problem.rows,
        degrees_of_freedom=problem.rows,
        start="nothing to estimate: every variable is held",
        steps=(),
        seconds={"total": 0.0},
        diagnosis=Diagnosis(free=(), everywhere=True),
        plan={},
    )


def _check(method: str, initial: str) -> None:
    if method not in METHODS:
        raise ConfigError(f"no solver '{method}'; there are {', '.join(METHODS)}{closest(method, METHODS)}")
    if initial not in STARTS:
        raise ConfigError(f"no start '{initial}'; there are {', '.join(STARTS)}{closest(initial, STARTS)}")


class _Run(NamedTuple):
    """What a search is made with."""

    minimize: Minimizer
    settings: SolverSettings
    observe: Observer
    clock: _Clock


def _search(
    problem: Problem, values: Values, initial: str, first: Cost, run: _Run
) -> tuple[Start, Minimum, tuple[Iteration, ...]]:
    """Minimise from the start that is chosen, and once more where the end says that it was the wrong one."""
    start = choose_start(problem, values, initial, first)
    run.clock.lap("start")
    constrained = any(group.constrained for group in problem.groups)
    minimize = _with_constraints(run.minimize) if constrained else run.minimize
    found = minimize(problem, run.settings, start.cost, run.observe)
    run.clock.lap("iterate")
    steps = found.iterations
    doubt = initial == "auto" and start.cost is first and not constrained
    again = second_start(problem, values, found) if doubt else None
    run.clock.lap("start")
    if again is not None:
        start = again
        found = minimize(problem, run.settings, start.cost, run.observe)
        steps += tuple(replace(step, number=step.number + len(steps)) for step in found.iterations)
        run.clock.lap("iterate")
    return start, found, steps


def _with_constraints(minimize: Minimizer) -> Minimizer:
    def held(problem: Problem, settings: SolverSettings, _: Cost, observe: Observer) -> Minimum:
        return minimize_constrained(minimize, problem, settings, observe)

    return held


def _ignore(_: Iteration) -> None:
    pass


class _Clock:
    """Seconds by stage."""

    def __init__(self) -> None:
        self._stages: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._last
        self._last = now

    def seconds(self) -> dict[str, float]:
        return {**self._stages, "total": sum(self._stages.values())}
