"""False loops in a graph that grows: let go incrementally, beside plain kernels and beside the graph without them.

Worlds of known truth with random false loops, seeds that nothing was tuned on, and public graphs with false loops
between random poses. Each graph is replayed one pose at a time: once without the false loops (`clean`), and with them
by each method. chi2 is that of the true factors alone, relative to the clean graph's batch optimum.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.graph import (
    ISAM2,
    Cauchy,
    GemanMcClure,
    Huber,
    OutlierRejection,
    PoseGraphFile,
    Values,
    read_pose_graph,
    solve,
)
from heliograph.graph.files.worlds import World, drive, grid_walk, manhattan, sphere, torus, with_false_loops
from heliograph.graph.incremental.replay import Replay, replay, replay_steps
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, SE3

__all__ = ["METHODS", "measure_outliers", "outliers_section"]

_Make = Callable[[np.random.Generator], World]
_WORLDS: dict[str, _Make] = {
    "manhattan": lambda rng: manhattan(1500, rng),
    "drive": lambda rng: drive(2000, rng),
    "grid": lambda rng: grid_walk(800, rng, levels=4),
    "sphere": lambda rng: sphere(12, 50, rng),
    "torus": lambda rng: torus(15, 40, rng),
}
_PUBLIC = ("intel", "M3500", "kitti_00")
METHODS: dict[str, Kernel | None] = {
    "clean": None,
    "gnc": None,
    "huber": Huber(1.345),
    "cauchy": Cauchy(2.385),
    "geman-mcclure": GemanMcClure(1.0),
}


def _cases(seeds: range, fraction: float, folder: Path) -> Iterator[tuple[str, int, World]]:
    for name, make in _WORLDS.items():
        for seed in seeds:
            rng = np.random.default_rng(seed)
            yield name, seed, with_false_loops(make(rng), fraction, rng)
    for name in _PUBLIC:
        path = folder / f"{name}.g2o"
        for seed in seeds if path.exists() else ():
            yield name, seed, with_false_loops(_world(read_pose_graph(path)), fraction, np.random.default_rng(seed))


def _world(file: PoseGraphFile) -> World:
    """Return a public graph as a world whose truth is its batch optimum."""
    solution = solve(file.graph(), file.odometry_values())
    group = SE2 if file.dimension == 2 else SE3
    i, j, T = file.edges
    table = file.of_role("between")[0]
    order = np.argsort(np.abs(j - i) != 1, kind="stable")
    keys = solution.values.block(group)[0]
    assert np.array_equal(np.sort(keys), np.arange(len(keys))), "ids that do not run from 0"
    truth = solution.values.at(np.arange(len(keys)))
    false = np.zeros(len(i), dtype=bool)
    return World(truth=truth, i=i[order], j=j[order], T_i_j=T[order], information=table.information[order], false=false)


def _replayed(file: PoseGraphFile, method: str) -> tuple[Replay, float]:
    """Return a replay, and the CPU time that it took [s]."""
    steps = list(replay_steps(file.graph(kernel=METHODS[method]), file.odometry_values()))
    began = time.process_time()
    done = replay(steps, ISAM2(outliers=OutlierRejection() if method == "gnc" else None))
    return done, time.process_time() - began


def _let_go(world: World, smoother: ISAM2) -> tuple[int, int]:
    """Return how many true factors were let go, and how many false ones were not."""
    gone = [tuple(smoother.keys_of(number).tolist()) for number in smoother.let_go.tolist()]
    pairs = list(zip(world.i.tolist(), world.j.tolist(), strict=True))
    false = [pair for pair, wrong in zip(pairs, world.false.tolist(), strict=True) if wrong]
    kept = sum(pair not in gone for pair in false)
    return len(gone) - (len(false) - kept), kept


def _clean(world: World) -> PoseGraphFile:
    keep = ~world.false
    information = np.broadcast_to(world.information, (len(world.i), *world.information.shape[-2:]))
    return PoseGraphFile.of(
        world.truth.space, edges=(world.i[keep], world.j[keep], world.T_i_j.matrix[keep], information[keep])
    )


def measure_outliers(folder: Path, *, seeds: range, fraction: float = 0.3) -> Iterator[dict[str, Any]]:
    """Yield one row a graph, seed and method."""
    for name, seed, world in _cases(seeds, fraction, folder):
        clean = _clean(world)
        graph = clean.graph()
        best: float | None = None
        for method in METHODS:
            done, cpu = _replayed(clean if method == "clean" else world.file, method)
            found = done.smoother.estimate()
            if best is None:
                best = solve(graph, found).chi2
            yield {
                "graph": name,
                "seed": seed,
                "method": method,
                "poses": len(world.truth),
                "loops": int(world.loops - world.false.sum()),
                "false": int(world.false.sum()),
                "chi2_ratio": Problem(graph, found).cost().chi2 / best,
                "ate_m": _error(world, found),
                **dict(zip(("true_let_go", "false_kept"), _let_go(world, done.smoother), strict=True)),
                "cpu_ms": 1e3 * cpu,
                "p50_ms": 1e3 * float(np.median(done.seconds)),
                "p99_ms": 1e3 * float(np.quantile(done.seconds, 0.99)),
            }


def _error(world: World, found: Values) -> float:
    positions = found.at(np.arange(len(world.truth))).translation
    return float(np.sqrt(np.mean(np.sum((positions - world.truth.translation) ** 2, axis=1))))


def outliers_section(rows: list[dict[str, Any]], table: Any) -> str:  # noqa: ANN401
    """Return the section: each graph, each method, medians and the worst over the seeds."""
    body = []
    for name in dict.fromkeys(row["graph"] for row in rows):
        clean = {row["seed"]: row for row in rows if (row["graph"], row["method"]) == (name, "clean")}
        for method in METHODS:
            mine = [row for row in rows if (row["graph"], row["method"]) == (name, method)]
            chi2 = [row["chi2_ratio"] for row in mine]
            times = [row["cpu_ms"] / clean[row["seed"]]["cpu_ms"] for row in mine]
            gnc = method == "gnc"
            body.append(
                [
                    f"{name}, {len(clean)}" if method == "clean" else "",
                    method,
                    f"{np.median(chi2):.4g}",
                    f"{max(chi2):.4g}",
                    f"{np.median([row['ate_m'] for row in mine]):.3g}",
                    f"{max(row['ate_m'] for row in mine):.3g}",
                    f"{sum(row['true_let_go'] for row in mine)} of {sum(row['loops'] for row in mine)}" if gnc else "-",
                    f"{sum(row['false_kept'] for row in mine)} of {sum(row['false'] for row in mine)}" if gnc else "-",
                    f"{np.median(times):.2f}",
                    f"{np.median([row['p50_ms'] for row in mine]):.3g}",
                    f"{np.median([row['p99_ms'] for row in mine]):.3g}",
                ]
            )
    head = [
        "graph",
        "method",
        "chi2",
        "worst",
        "ATE m",
        "worst m",
        "true let go",
        "false kept",
        "time",
        "50 % ms",
        "99 % ms",
    ]
    return (
        "## False loops in a graph that grows\n\n"
        + table(head, body)
        + "\nWith the number of seeds; three false loops for ten true ones, between random poses. One pose at a time, "
        "no batch solve. chi2: of the true factors, in units of the batch optimum without false loops. `clean` is "
        "iSAM2 without them, `gnc` is `ISAM2(outliers=OutlierRejection())`, the others are kernels on every relative "
        "pose. ATE: to the truth, of public graphs to the optimum without false loops. Time: CPU of all updates, in "
        "units of clean's; an update's by the clock.\n"
    )
