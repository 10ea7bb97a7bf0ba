"""Pose graphs: time to the optimum beside gtsam, g2o and Ceres, one thread, every solver from the same start.

Every program reads the same file, whose vertices are the odometry start. Runs alternate between the programs, each in a
fresh process on one core, which solves once to warm up and once on the clock. Whatever a program's own objective is,
its poses are scored by one function here.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.process import Cost, attempt
from heliograph.graph import PoseGraphFile, read_pose_graph, write_g2o
from heliograph.lie import SE2, SE3, se2, se3, so2, so3

__all__ = ["GRAPHS", "SOLVERS", "Solver", "chi2", "compare", "prepare", "run_once"]

GRAPHS = ("M3500", "intel", "kitti_00", "sphere2500", "parking-garage", "smallGrid3D")
SAME_OPTIMUM = 1e-4  # relative: how far above the best chi2 a solver may end
_HERE = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True, kw_only=True)
class Solver:
    """A system and how it is called: `system` decides program and environment, `options` follow the output's name."""

    system: str
    options: tuple[str, ...]

    @property
    def name(self) -> str:
        """As printed."""
        return " ".join([self.system, *self.options])


_GTSAM = [
    ("gtsam", method, linear, ordering)
    for method in ("gn", "lm")
    for linear in ("MULTIFRONTAL_CHOLESKY", "SEQUENTIAL_CHOLESKY")
    for ordering in ("COLAMD", "METIS")
]
_OTHERS = [("g2o", "gn"), ("g2o", "lm"), ("g2o", "dl"), ("ceres", "lm"), ("ceres", "dl")]
_OURS = [("heliograph", "lm"), ("heliograph", "gn"), ("heliograph", "dogleg")]
SOLVERS = tuple(Solver(system=row[0], options=tuple(row[1:])) for row in [*_OURS, *_GTSAM, *_OTHERS])


def prepare(source: PoseGraphFile, target: Path) -> PoseGraphFile:
    """Write a graph with its odometry start as vertices, ids counted from 0, and return it."""
    ids, values = source.pose_ids, source.odometry_values()
    i, j, T_i_j = source.edges
    tables = source.of_role("between")
    order = np.argsort(np.concatenate([t.line for t in tables]), kind="stable")
    information = np.concatenate([t.information for t in tables])[order]
    graph = PoseGraphFile.of(
        source.dimension,
        edges=(np.searchsorted(ids, i), np.searchsorted(ids, j), T_i_j.matrix, information),
        poses=(np.arange(len(ids)), values.at(ids).matrix),
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    write_g2o(target, graph)
    return read_pose_graph(target)


def chi2(graph: PoseGraphFile, T_world_i: NDArray[np.float64]) -> float:
    """Return sum r' Omega r with r = Log(Z^-1 Xi^-1 Xj): no factor 1/2, no kernel; poses in the order of their ids."""
    i, j, T_i_j = graph.edges
    lie: Any = se2 if graph.dimension == 2 else se3
    seen = lie.inverse(T_world_i[i]) @ T_world_i[j]
    r = lie.log(lie.inverse(T_i_j.matrix) @ seen)
    information = graph.of_role("between")[0].information
    return float(np.einsum("ea,eab,eb->", r, information, r, optimize=True))


def command(
    solver: Solver, graph: Path, out: Path, programs: dict[str, Path], *, cold: bool = False, script: str = "batch"
) -> list[str]:
    """Return the command line of a solver."""
    tail = [str(graph), str(out), *solver.options, *(["--cold"] if cold else [])]
    if solver.system == "ceres":
        return [str(programs["ceres"]), *tail]
    python = programs["heliograph" if solver.system.startswith("heliograph") else "rivals"]
    return [str(python), str(_HERE / "graph_rivals" / f"{solver.system.replace('-', '_')}_{script}.py"), *tail]


def run_once(
    solver: Solver,
    graph: Path,
    work: Path,
    programs: dict[str, Path],
    *,
    cold: bool = False,
    limit: float = 600.0,
    script: str = "batch",
) -> tuple[dict[str, Any] | None, Path, Cost | None]:
    """Run a solver in a process of its own; None in place of its account where it failed or took too long."""
    out = (
        work
        / f"{graph.stem}_{'_'.join([solver.system, *solver.options])}{'.txt' if solver.system == 'ceres' else '.npy'}"
    )
    log = out.with_suffix(".log")
    line = command(solver, graph, out, programs, cold=cold, script=script)
    cost = attempt(line, log=log, environment={}, cores=1, limit=limit)
    if cost is None:
        return None, out, None
    lines = [line for line in log.read_text().splitlines() if line.startswith("{")]
    return json.loads(lines[-1]), out, cost


def poses(file: Path, dimension: int) -> NDArray[np.float64]:
    """Return what a program wrote as homogeneous matrices."""
    if file.suffix == ".npy":
        return np.asarray(np.load(file))
    rows = np.loadtxt(file, ndmin=2)
    if dimension == 2:
        return SE2.from_rotation_translation(so2.exp(rows[:, 2:]), rows[:, :2]).matrix
    return SE3.from_rotation_translation(so3.from_quaternion(rows[:, 3:]), rows[:, :3]).matrix


def compare(
    sources: dict[str, Path], solvers: Sequence[Solver], work: Path, programs: dict[str, Path], *, runs: int
) -> list[dict[str, Any]]:
    """Return one row a graph and solver: median seconds, chi2 by our measure, whether it reached the optimum."""
    rows = []
    for name, source in sources.items():
        graph = prepare(read_pose_graph(source), work / f"{name}.g2o")
        found: dict[Solver, list[dict[str, Any]]] = {solver: [] for solver in solvers}
        scores: dict[Solver, float] = {}
        for turn in range(runs):
            for solver in solvers:
                if turn and not found[solver]:
                    continue  # it failed in the first turn
                account, out, _ = run_once(solver, work / f"{name}.g2o", work, programs)
                if account is not None:
                    found[solver].append(account)
                    scores[solver] = chi2(graph, poses(out, graph.dimension))
            print(f"{name}: turn {turn + 1} of {runs}", file=sys.stderr, flush=True)
        best = min(scores.values())
        rows += [_row(name, graph, solver, found[solver], scores.get(solver), best) for solver in solvers]
    return rows


def _row(
    name: str, graph: PoseGraphFile, solver: Solver, found: list[dict[str, Any]], score: float | None, best: float
) -> dict[str, Any]:
    row = {
        "benchmark": "graph",
        "graph": name,
        "poses": len(graph.pose_ids),
        "edges": graph.edge_count,
        "system": solver.system,
        "options": list(solver.options),
        "runs": len(found),
    }
    if not found or score is None:
        return {**row, "failed": True, "reached": False}
    seconds = [account["seconds"] for account in found]
    return {
        **row,
        "failed": False,
        "version": found[-1]["version"],
        "seconds": statistics.median(seconds),
        "seconds_all": [round(s, 6) for s in seconds],
        "iterations": found[-1]["iterations"],
        "chi2": score,
        "reached": bool(score <= best * (1.0 + SAME_OPTIMUM)),
    }
