"""A tunnel with wheels or legs, and without: along-axis error, scale, slip, and what the graph says of itself.

``python -m benchmarks.wheels FIRST LAST [SCENARIO...]`` simulates each recording, runs it whole with the back-end in
this process, and prints a row a run; the last lines are the table.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.healthy import InMemory, Poses
from heliograph import pipeline
from heliograph.config import RunConfig
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Marginals, Symbol, load_graph
from heliograph.lie import se3
from heliograph.sim import SCENARIOS, Simulation

__all__ = ["measure_wheels", "wheels_section"]

X = Symbol("X")
_HEAD = """## Wheels and legs

Errors at the end along the way, with the speeds and without. `tunnel-wheels` is 290 m, 148 m of them blind, wheels 3 %
wrong with three spells of slip; `tunnel-legs` and `open-legs` have leg odometry 3 % wrong with impacts. 16 beams of 360
points. `python -m benchmarks.wheels FIRST LAST`, seeds not used before. Bars: 0.5 % of the way, scale to 0.3 %.

"""
_SCENARIOS = {
    "tunnel-wheels": SCENARIOS["tunnel-wheels"].thinned(beams=16, columns=360),
    "tunnel-legs": SCENARIOS["tunnel-legs"].thinned(beams=16, columns=360),
    "open-legs": replace(SCENARIOS["warehouse"].thinned(beams=16, columns=360, duration=60.0), name="open-legs",
                         wheels=SCENARIOS["tunnel-legs"].wheels),
}  # fmt: skip


def measure_wheels(seeds: Iterable[int], names: Iterable[str] = (), *, beside: bool = True) -> Iterator[dict[str, Any]]:
    """Yield a row a recording and way: with its speeds, and ``beside`` them without."""
    for seed in seeds:
        for name in list(names) or list(_SCENARIOS):
            source = InMemory(_SCENARIOS[name], seed)
            log = Simulation(_SCENARIOS[name], seed).wheels()
            for with_speeds in (True, False) if beside else (True,):
                with tempfile.TemporaryDirectory(prefix="heliograph_") as folder:
                    yield {
                        "kind": "wheels", "scenario": name, "seed": seed, "speeds": with_speeds,
                        **_run(source, log, Path(folder), with_speeds=with_speeds),
                    }  # fmt: skip


def _run(source: InMemory, log: Any, folder: Path, *, with_speeds: bool) -> dict[str, Any]:  # noqa: ANN401
    config = RunConfig(threads=1)
    if with_speeds:
        (folder / "wheels.csv").write_text(log.csv(), encoding="utf-8")
        config = replace(config, wheels=replace(config.wheels, file=str(folder / "wheels.csv")))
    poses, began = Poses(), time.process_time()
    summary = pipeline.run(source, config, sinks=[poses], folder=folder)
    seconds = time.process_time() - began
    stamps = np.array(poses.stamps_ns, dtype=np.int64)
    T_odom = np.stack(poses.poses)
    final = summary.final_poses
    T = T_odom if final is None else final.T_map_odom(stamps) @ T_odom
    truth = source.truth.pose(stamps)
    keys = np.searchsorted(stamps, _keyframe_stamps(folder))
    graph, values = load_graph(folder / "graph.npz", factors=SENSOR_FACTORS)
    last = keys[-1]
    off = se3.log(se3.inverse(se3.inverse(truth[keys[0]]) @ truth[last]) @ se3.inverse(T[keys[0]]) @ T[last])
    marginals = Marginals(graph, values)
    P = marginals.covariance(int(X(len(keys) - 1)))[:6, :6]
    way = truth[last, :3, 3] - truth[keys[0], :3, 3]
    axis = truth[last, :3, :3].T @ (way / np.linalg.norm(way))
    along, sigma = float(axis @ off[3:]), float(np.sqrt(axis @ P[3:, 3:] @ axis))
    wheels = summary.graph.wheels if summary.graph is not None else None
    return {
        "status": summary.status,
        "length_m": float(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()),
        "along_m": along,
        "along_sigma_m": sigma,
        "position_m": float(np.linalg.norm(off[3:])),
        "nees": float(off @ np.linalg.solve(P, off)),
        "nees_position": float(off[3:] @ np.linalg.solve(P[3:, 3:], off[3:])),
        "scale": None if wheels is None else wheels.scale,
        "scale_sigma": None if wheels is None else wheels.scale_sigma,
        "steps": 0 if wheels is None else wheels.steps,
        "slips": 0 if wheels is None else wheels.slips,
        "spells": int(np.count_nonzero(np.diff(log.slipping.astype(int)) > 0)),
        "events": [event.code for event in summary.events if event.code.startswith("wheel")],
        "cpu_s": seconds,
    }


def _keyframe_stamps(folder: Path) -> np.ndarray:
    from heliograph.slam import KEYFRAMES, KeyframeStore

    store = KeyframeStore.open(folder / KEYFRAMES)
    stamps = np.array(store.stamps_ns)
    store.close()
    return stamps


def wheels_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[Any]]], str]) -> str:
    """Return the section of a set of rows."""
    head = [
        "scenario", "speeds", "runs", "way m", "along, RMS / worst m", "of the way, worst", "sigma along, median m",
        "NEES along (1)", "scale, RMS error / sigma", "slip told",
    ]  # fmt: skip
    body: list[list[Any]] = []
    for name in dict.fromkeys(row["scenario"] for row in rows):
        for with_speeds in (True, False):
            some = [row for row in rows if row["scenario"] == name and row["speeds"] == with_speeds]
            if some:
                body.append(_cells(name, some))
    return _HEAD + table(head, body)


def _cells(name: str, some: Sequence[dict[str, Any]]) -> list[Any]:
    along, way = (np.array([row[key] for row in some]) for key in ("along_m", "length_m"))
    scale, told = "-", "-"
    if some[0]["speeds"]:
        off = np.array([row["scale"] for row in some], dtype=float) - _SCENARIOS[name].wheels.scale
        scale = f"{1e2 * np.sqrt(np.mean(off**2)):.2f} % / {1e2 * np.median([r['scale_sigma'] for r in some]):.2f} %"
        told = f"{sum('wheel-slip' in row['events'] for row in some)} of {len(some)}"
    return [
        name,
        "yes" if some[0]["speeds"] else "no",
        str(len(some)),
        f"{way.mean():.0f}",
        f"{np.sqrt(np.mean(along**2)):.3f} / {np.abs(along).max():.3f}",
        f"{1e2 * np.abs(along / way).max():.2f} %",
        f"{np.median([row['along_sigma_m'] for row in some]):.3f}",
        f"{np.mean([(row['along_m'] / row['along_sigma_m']) ** 2 for row in some]):.2f}",
        scale,
        told,
    ]


def main(arguments: Sequence[str]) -> None:
    """Print a row a run, and the table."""
    first, last, *names = arguments
    rows = []
    for row in measure_wheels(range(int(first), int(last) + 1), names):
        rows.append(row)
        print(row, flush=True)
    from benchmarks.table import _table

    print(wheels_section(rows, _table))


if __name__ == "__main__":
    main(sys.argv[1:])
