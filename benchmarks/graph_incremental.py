"""Incremental smoothing beside gtsam's iSAM2: poses one at a time, in one order, with one threshold, on one thread.

What counts is the update and the reading of the one earlier pose from which the next one starts. Runs alternate, each
in a process of its own. The graph `hard` has information from 20 to 4e8: gtsam's update aborts on it.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.graph import Solver, chi2, poses, prepare, run_once
from heliograph.graph import PoseGraphFile, read_pose_graph, solve
from heliograph.graph.files.worlds import drive, uneven

__all__ = ["INCREMENTAL_GRAPHS", "compare_incremental", "measure_incremental_scale"]

INCREMENTAL_GRAPHS = ("M3500", "intel", "kitti_00", "sphere2500", "parking-garage", "hard")
_SCALE_POSES = 1_000_000
_LIMIT = 500.0  # seconds of updates
_LAG = "200"  # poses that the fixed-lag smoother keeps
_BOUNDS = ("2000", "500")  # of the work of one update on the long drive: `max_steps`, `max_relinearized`
_SEED = 1
_STATISTICS = ("seconds", "mean_ms", "p50_ms", "p99_ms", "max_ms")


def _solvers(skips: Sequence[int], limit: float) -> list[Solver]:
    return [
        Solver(system=system, options=(str(skip), f"{limit:g}")) for skip in skips for system in ("heliograph", "gtsam")
    ]


def compare_incremental(
    folder: Path, names: Sequence[str], work: Path, programs: dict[str, Path], *, runs: int
) -> list[dict[str, Any]]:
    """Return one row a graph and solver: medians over the runs of total, mean, percentiles and maximum; last chi2."""
    rows = []
    solvers = [s for s in _solvers((1, 10), _LIMIT) if s.system == "heliograph" or programs["rivals"].exists()]
    for name in names:
        path = work / f"{name}.g2o"
        file = uneven(np.random.default_rng(_SEED)).file if name == "hard" else read_pose_graph(folder / f"{name}.g2o")
        graph = prepare(file, path)
        best = solve(graph.graph(), graph.values()).chi2
        found: dict[Solver, list[dict[str, Any]]] = {solver: [] for solver in solvers}
        outs: dict[Solver, Path] = {}
        for turn in range(runs):
            for solver in solvers:
                account, outs[solver], _ = run_once(solver, path, work, programs, script="isam2")
                found[solver] += [] if account is None else [account]
            print(f"{name}: turn {turn + 1} of {runs}", file=sys.stderr, flush=True)
        rows += [_row(name, graph, solver, found[solver], outs[solver], best) for solver in solvers if found[solver]]
    return rows


def _row(
    name: str, graph: PoseGraphFile, solver: Solver, found: list[dict[str, Any]], out: Path, best: float
) -> dict[str, Any]:
    whole = found[-1]["updates"] == len(graph.pose_ids)
    return {
        "benchmark": "graph_incremental",
        "graph": name,
        "poses": len(graph.pose_ids),
        "edges": graph.edge_count,
        "system": solver.system,
        "skip": int(solver.options[0]),
        "runs": len(found),
        **{key: statistics.median(account[key] for account in found) for key in _STATISTICS},
        "updates": found[-1]["updates"],
        "fault": found[-1]["fault"],
        "chi2": chi2(graph, poses(out, graph.dimension)) if whole else None,
        "batch_chi2": best,
        "version": found[-1]["version"],
    }


def measure_incremental_scale(
    work: Path, programs: dict[str, Path], *, count: int = _SCALE_POSES, limit: float = _LIMIT
) -> list[dict[str, Any]]:
    """Return one row a system for a drive with few loops: what happens by tenths of the run, as far as it gets.

    Heliograph's updates are bounded by `_BOUNDS`; gtsam has no such setting.
    """
    path = work / f"drive_{count}.g2o"
    if not path.exists():
        prepare(drive(count, np.random.default_rng(_SEED), sigmas=(0.0002, 0.02)).file, path)
    rows = []
    lagged = Solver(system="heliograph-lag", options=(_LAG,))
    ours, gtsam = _solvers((1,), limit)
    for solver in (replace(ours, options=(*ours.options, *_BOUNDS)), gtsam, lagged):
        if solver.system == "gtsam" and not programs["rivals"].exists():
            continue
        account, _, cost = run_once(solver, path, work, programs, script="isam2", limit=4.0 * limit + 600.0)
        row = {"benchmark": "graph_incremental_scale", "poses": count, "system": solver.system, "skip": 1}
        peak = None if cost is None else cost.peak_mb
        rows.append({**row, "failed": account is None, "peak_mb": peak, **(account or {})})
    return rows
