"""`heliograph solve --solver isam2`: a graph replayed one pose at a time, timed, then iterated to convergence."""

from __future__ import annotations

import gc
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.cli.activity import stage

if TYPE_CHECKING:
    from heliograph.graph import FactorGraph, ISAM2Settings, OutlierRejection, Values
    from heliograph.graph.incremental.replay import Replay

__all__ = ["Incremental", "solve_incrementally"]

_STEP_TOLERANCE = 1e-9  # longest element of a step at the end [rad, m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Incremental:
    """What the replay found, in the words of a `Solution`, and what only a replay has: `facts`."""

    values: Values
    status: str
    start: str
    iterations: int
    initial_chi2: float
    chi2: float
    cost: float
    degrees_of_freedom: int
    seconds: dict[str, float]
    facts: dict[str, Any]


def solve_incrementally(
    graph: FactorGraph, values: Values, settings: ISAM2Settings, outliers: OutlierRejection | None = None
) -> Incremental:
    """Replay a graph; the values are its odometry, of which only those of held poses and of priors are used.

    With `outliers`, chi2, cost and degrees of freedom at the end are those of the factors that count.

    Raises
    ------
    GraphError
        The graph cannot be replayed or does not determine its variables; the message says why.
    """
    from heliograph.graph import ISAM2
    from heliograph.graph.incremental.replay import replay, replay_steps
    from heliograph.graph.problem.problem import Problem

    stage("preparing the replay")
    steps = list(replay_steps(graph, values))
    odometry = Problem(graph, values)
    initial = odometry.cost()
    smoother = ISAM2(settings, outliers=outliers)
    stage(f"solving, {len(steps)} updates one by one")
    gc.collect()
    gc.freeze()  # the prepared steps are no garbage: the collector need not look through them during the replay
    try:
        done = replay(steps, smoother)
    finally:
        gc.unfreeze()
    last = Problem(graph, smoother.estimate()).cost().chi2
    begin = time.perf_counter()
    finish = smoother.update(iterate=_STEP_TOLERANCE, costs=outliers is not None)
    finish_seconds = time.perf_counter() - begin
    found = smoother.estimate()
    final = Problem(graph, found).cost()
    chi2, cost, rows, facts = final.chi2, final.cost, odometry.rows, {}
    if outliers is not None:
        chi2 = cost = finish.cost_after or 0.0
        last = finish.cost_before or 0.0
        facts["let_go"] = [smoother.keys_of(number).tolist() for number in smoother.let_go.tolist()]
        rows -= smoother.rows_let_go
    update_seconds = float(sum(done.seconds))
    return Incremental(
        values=found,
        status="converged" if finish.converged else "max_iterations",
        start="odometry on the current estimate",
        iterations=finish.iterations,
        initial_chi2=initial.chi2,
        chi2=chi2,
        cost=cost,
        degrees_of_freedom=rows - odometry.free_scalars,
        seconds={"updates": update_seconds, "finish": finish_seconds, "total": update_seconds + finish_seconds},
        facts={
            **_timing(done),
            "relinearize_skip": settings.relinearize_skip,
            "relinearize_threshold": settings.relinearize_threshold,
            "wildfire": settings.wildfire,
            "last_update_chi2": last,
            "finish_seconds": finish_seconds,
            "bytes_per_pose": smoother.bytes / len(steps),
            **facts,
        },
    )


def _timing(done: Replay) -> dict[str, Any]:
    milliseconds = 1e3 * np.array(done.seconds)
    return {
        "updates": len(done.seconds),
        "update_seconds": float(sum(done.seconds)),
        "mean_ms": float(milliseconds.mean()),
        "p50_ms": float(np.percentile(milliseconds, 50)),
        "p99_ms": float(np.percentile(milliseconds, 99)),
        "max_ms": float(milliseconds.max()),
        "reeliminated": int(sum(done.reeliminated)),
        "relinearized": int(sum(done.relinearized)),
        "waited": done.waited,
    }
