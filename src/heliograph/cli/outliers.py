"""`heliograph solve --robust gnc`: what it was given, and a batch solve without the outliers."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from heliograph.cli.incremental import Incremental
    from heliograph.graph import FactorGraph, Values

__all__ = ["settings_of", "solve_at_once"]


def settings_of(text: str) -> tuple[str, float | None]:
    """Return name and probability of ``NAME`` or ``NAME:PROBABILITY``.

    Raises
    ------
    ConfigError
        The probability is none.
    """
    from heliograph.errors import ConfigError

    name, _, given = text.partition(":")
    if not given:
        return name, None
    try:
        probability = float(given)
    except ValueError:
        probability = float("nan")
    if not 0.0 < probability < 1.0:
        raise ConfigError(
            f"--robust {text}: '{given}' is no probability; give one between 0 and 1, such as {name}:0.99"
        )
    return name, probability


def solve_at_once(
    graph: FactorGraph, values: Values, name: str, probability: float | None, threads: int
) -> Incremental:
    """Solve with `solve_robust`; chi2, cost and degrees of freedom at the end are those of the factors that count.

    Raises
    ------
    GraphError
        The graph does not fit the values.
    """
    from heliograph.cli.incremental import Incremental
    from heliograph.graph import RobustSettings, solve_robust
    from heliograph.graph.problem.problem import Problem

    given = {} if probability is None else {"probability": probability}
    settings = RobustSettings(surrogate="gm" if name == "gnc-gm" else "tls", **given)  # type: ignore[arg-type]
    start = Problem(graph, values)
    initial = start.cost()
    begin = time.perf_counter()
    found = solve_robust(graph, values, settings=settings, threads=threads)
    seconds = time.perf_counter() - begin
    let_go, rows = [], start.rows
    for added in graph.groups():
        for row in range(len(added.record)):
            if not found.inliers[added.first + row]:
                let_go.append(added.record.keys[row].tolist())
                rows -= added.record.rows
    return Incremental(
        values=found.values,
        status=found.status,
        start=found.start,
        iterations=found.iterations,
        initial_chi2=initial.chi2,
        chi2=found.chi2,
        cost=found.chi2,
        degrees_of_freedom=rows - start.free_scalars,
        seconds={"total": seconds},
        facts={"let_go": let_go},
    )
