"""Pose graphs of growing size: seconds and peak memory of a child process each, and the exponents with which they grow.

Manhattan worlds of 10^4 to 10^6 poses, and walks of 10^5 on a cubic grid in space (few loops: elimination of a cube is
of order n^2 for every solver) and in a building of four floors; rivals at 10^5. The start is the odometry.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.graph import SAME_OPTIMUM, Solver, chi2, poses, prepare, run_once
from heliograph.graph import PoseGraphFile, read_pose_graph
from heliograph.graph.files.worlds import World, grid_walk, manhattan

__all__ = ["RIVALS", "WORLDS", "exponent", "measure_scale"]

_OURS = Solver(system="heliograph", options=("lm", "auto"))  # as a user runs it
RIVALS = (
    Solver(system="gtsam", options=("gn", "MULTIFRONTAL_CHOLESKY", "METIS")),
    Solver(system="gtsam", options=("gn", "MULTIFRONTAL_CHOLESKY", "COLAMD")),
    Solver(system="gtsam", options=("lm", "MULTIFRONTAL_CHOLESKY", "METIS")),
    Solver(system="g2o", options=("gn",)),
    Solver(system="g2o", options=("dl",)),
    Solver(system="ceres", options=("lm",)),
    Solver(system="ceres", options=("dl",)),
)
# Turns so exact that odometry over 10^6 poses is a start at all; M3500's would have turned round many times.
_SIGMAS = (0.002, 0.02)
_SEED = 1
_COMPARED = 100_000  # poses at which rivals run

_Maker = Callable[[int, np.random.Generator], World]
WORLDS: dict[str, tuple[_Maker, int]] = {
    "manhattan_1e4": (lambda n, rng: manhattan(n, rng, sigmas=_SIGMAS), 10_000),
    "manhattan_1e5": (lambda n, rng: manhattan(n, rng, sigmas=_SIGMAS), 100_000),
    "manhattan_1e6": (lambda n, rng: manhattan(n, rng, sigmas=_SIGMAS), 1_000_000),
    "grid3d_1e5": (lambda n, rng: grid_walk(n, rng, loops=0.1, sigmas=_SIGMAS), 100_000),
    "building_1e5": (lambda n, rng: grid_walk(n, rng, levels=4, sigmas=_SIGMAS), 100_000),
}


def measure_scale(
    names: Sequence[str], work: Path, programs: dict[str, Path], *, runs: int, rivals: bool = True
) -> list[dict[str, Any]]:
    """Return one row a world and solver: median seconds, peak memory of the process, chi2 by our measure."""
    rows = []
    for name in names:
        maker, count = WORLDS[name]
        path = work / f"{name}.g2o"
        graph = read_pose_graph(path) if path.exists() else _made(maker, count, path)
        solvers = (_OURS, *(RIVALS if rivals and count == _COMPARED else ()))
        part = [_row(name, graph, solver, path, work, programs, runs) for solver in solvers]
        best = min(row["chi2"] for row in part if not row["failed"])
        rows += [{**row, "reached": not row["failed"] and row["chi2"] <= best * (1.0 + SAME_OPTIMUM)} for row in part]
    return rows


def _made(maker: _Maker, count: int, path: Path) -> PoseGraphFile:
    return prepare(maker(count, np.random.default_rng(_SEED)).file, path)


def _row(
    name: str, graph: PoseGraphFile, solver: Solver, path: Path, work: Path, programs: dict[str, Path], runs: int
) -> dict[str, Any]:
    row = {
        "benchmark": "graph_scale",
        "graph": name,
        "poses": len(graph.pose_ids),
        "edges": graph.edge_count,
        "system": solver.system,
        "options": list(solver.options),
        "failed": True,
    }
    accounts, peaks, bases, out = [], [], [], path
    for turn in range(runs):
        account, out, cost = run_once(solver, path, work, programs, cold=True)
        if account is None or cost is None:
            return row
        accounts.append(account)
        peaks.append(cost.peak_mb)
        bases += _base(out.with_suffix(".log"))
        print(f"{name}: {solver.name} turn {turn + 1}: {account['seconds']:.2f} s", file=sys.stderr, flush=True)
    return {
        **row,
        "failed": False,
        "version": accounts[-1]["version"],
        "seconds": statistics.median(a["seconds"] for a in accounts),
        "seconds_all": [round(a["seconds"], 4) for a in accounts],
        "iterations": accounts[-1]["iterations"],
        "peak_mb": max(peaks),
        "base_mb": max(bases) if bases else None,
        "chi2": chi2(graph, poses(out, graph.dimension)),
    }


def _base(log: Path) -> list[float]:
    """Return the memory of the process before it read anything, where it said so."""
    return [float(line.split()[1]) for line in log.read_text().splitlines() if line.startswith("base ")]


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return the p of ``value ~ size^p`` by least squares of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])
