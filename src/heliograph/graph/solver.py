"""The solver of a finished graph: batch estimation, and an incremental replay where that ends in a wrong valley."""

from __future__ import annotations

import time
from dataclasses import replace

from heliograph.errors import GraphError
from heliograph.graph.batch.outcome import Observer
from heliograph.graph.batch.solution import POOR_COST, Solution
from heliograph.graph.batch.solve import solve as solve_batch
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.values import Values
from heliograph.graph.problem.settings import SolverSettings

__all__ = ["solve"]

_FEW = 20  # iterations: who allows only a few gets no more of them
_CONVERGED = 1e-6  # longest element of a step at the end of a replay [rad, m]


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
    """Minimise the sum of squared (robust) residuals of a graph.

    Parameters
    ----------
    graph : FactorGraph
        The factors, and which variables are held.
    values : Values
        Where to start; one value for every variable.
    method : str
        ``lm`` (Levenberg-Marquardt), ``gn`` (Gauss-Newton) or ``dogleg``.
    initial : str
        ``given``; ``chordal``; ``auto``: the given one, unless it has many rotations far off or ends badly, and the
        chordal one costs less; where the end is still poor, the graph is replayed pose by pose with `ISAM2` and solved
        from there.
    settings : SolverSettings, optional
        When to stop, ordering.
    threads : int
        For the native parts; the result is the same bits for any number.
    observer : callable, optional
        Given every `Iteration`.

    Returns
    -------
    Solution
        Its `warnings` say what is doubtful about it.

    Raises
    ------
    GraphError
        The graph does not fit the values, or a residual is not finite.
    UnderconstrainedError
        Variables are not determined by the graph; the message names them and the directions in which they are free.
    """
    found = solve_batch(graph, values, method, initial=initial, settings=settings, threads=threads, observer=observer)
    if initial != "auto" or not _doubtful(found, graph):
        return found
    begin = time.perf_counter()
    start = _replayed(graph, values)
    spent = time.perf_counter() - begin
    if start is None:
        return found
    again = solve_batch(graph, start, method, initial="given", settings=settings, threads=threads, observer=observer)
    seconds = {name: found.seconds.get(name, 0.0) + again.seconds[name] for name in again.seconds}
    seconds = {**found.seconds, **seconds, "replay": spent, "total": seconds["total"] + spent}
    if not again.cost < found.cost:
        return replace(found, seconds=seconds)
    first = len(found.steps)
    return replace(
        again,
        initial_chi2=found.initial_chi2,
        initial_cost=found.initial_cost,
        iterations=found.iterations + again.iterations,
        steps=(*found.steps, *(replace(step, number=step.number + first) for step in again.steps)),
        start=f"replayed pose by pose (the {found.start.split(' ')[0]} start ended at chi2 {found.chi2:.6g}, the "
        f"replay at {again.initial_chi2:.6g})",
        seconds=seconds,
    )


def _doubtful(found: Solution, graph: FactorGraph) -> bool:
    """Return whether a replay may find a better end.

    A chordal start judges relative poses by themselves already, and honest noise has one cost a degree of freedom. It
    does not see by landmarks, though, and what is replayed does.
    """
    if found.status == "max_iterations" and found.iterations < _FEW:
        return False
    if found.status != "converged":
        return True
    sighted = any(added.record.kind == "Landmark" for added in graph.groups())
    return sighted and found.cost > POOR_COST * max(found.degrees_of_freedom, 1)


def _replayed(graph: FactorGraph, values: Values) -> Values | None:
    """Return what incremental smoothing finds, or None where the graph cannot be replayed."""
    from heliograph.graph.incremental.replay import replay, replay_steps  # few graphs need it

    try:
        smoother = replay(replay_steps(graph, values)).smoother
        smoother.update(iterate=_CONVERGED)
    except GraphError:  # UnderconstrainedError is one
        return None
    found, out = smoother.estimate(), values.copy()
    for family in values.families():
        keys, _ = values.block(family)
        if len(keys):
            out.update(keys, found.at(keys))
    return out
