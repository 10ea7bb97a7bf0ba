"""Heliograph beside its peers. Results go to benchmarks/results/, the table to benchmarks/BENCHMARKS.md."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import (
    blind,
    calibrate,
    global_alignment,
    graph,
    graph_incremental,
    graph_scale,
    graph_sigmas,
    healthy,
    imu,
    imu_gnss,
    kd_tree,
    kitti,
    lab,
    lio,
    live,
    loam,
    localization_table,
    loop_misled,
    loop_runs,
    loops,
    match_scores,
    outages,
    outliers,
    registration,
    report_page,
    side_by_side,
    sigmas,
    speed,
    start,
    table,
    wheels,
)
from benchmarks.rivals import ADAPTERS, Adapter

_ROOT = Path(__file__).resolve().parent.parent
_RESULTS = _ROOT / "benchmarks" / "results"
_GRAPHS = ("graph", "graph-scale", "graph-incremental", "graph-incremental-scale", "graph-outliers")
_LOAM = ("walk", "shake", "warehouse", "kitti_0005", "traffic", "forest", "rough")
_CLOUDS = ("registration", "global", "blind", "kd-tree", "loam")
_ALL = (
    "kitti",
    "sharpness",
    "speed",
    "live",
    "lab",
    "report-page",
    "start",
    *_GRAPHS,
    "imu",
    "imu-gnss",
    "lio",
    "calibrate",
    *_CLOUDS,
    "loops",
    "loop-runs",
    "graph-sigmas",
    "side-by-side",
    "localization",
    "sigmas",
    "match-scores",
    "healthy",
    "outages",
    "wheels",
)
_NEEDS_DATA = ("kitti", "sharpness", "graph", "graph-incremental", "imu-gnss", "lio", "localization")
_RUNS = {
    "imu": 20,
    "lio": 5,
    "speed": 5,
    "start": 3,
    "graph": 7,
    "graph-scale": 1,
    "graph-incremental": 5,
    "graph-outliers": 2,
    "loops": 3,
    "loop-runs": 2,
    "graph-sigmas": 20,
    "sigmas": 20,
    "match-scores": 2,
    "healthy": 20,
    "outages": 5,
    "report-page": 5,
    "wheels": 8,
}
_TIMED = ("heliograph", "rko-lio")  # LiDAR alone loses its way on a walk, and then takes minutes


def _write(name: str, rows: Iterable[dict[str, Any]]) -> None:
    """Write rows as they come, so that one that fails costs none of those before it."""
    _RESULTS.mkdir(exist_ok=True)
    partial = _RESULTS / f"{name}.partial"
    with partial.open("w") as file:
        for row in rows:
            line = json.dumps(row)
            print(line, file=file, flush=True)
            print(line, flush=True)
    partial.replace(_RESULTS / f"{name}.jsonl")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("benchmark", choices=[*_ALL, "table", "all"])
    parser.add_argument("--data", type=Path, default=_ROOT.parent / "shared" / "data" / "kitti_0005", help="KITTI 0005")
    parser.add_argument("--simulated", type=Path, help="simulated recording for `speed`; made if not given")
    parser.add_argument("--work", type=Path, default=_ROOT / "build" / "bench", help="scratch folder")
    parser.add_argument(
        "--rival-bin", type=Path, default=_ROOT / "build" / "bench-venv" / "bin", help="rivals' programs"
    )
    parser.add_argument("--systems", nargs="+", choices=list(ADAPTERS), help=f"default: all; speed: {_TIMED}")
    parser.add_argument("--runs", type=int, help=f"runs a system; default: {_RUNS}")
    parser.add_argument(
        "--graphs", nargs="+", help=f"for `graph`: {graph.GRAPHS}; `graph-scale`: {list(graph_scale.WORLDS)}"
    )
    parser.add_argument("--seconds", type=float, default=45.0, help="length of the simulated recording")
    parser.add_argument("--trials", type=int, default=100, help="recordings of each motion of `calibrate`")
    parser.add_argument("--first", type=int, default=0, help="seed of the first of them, to share them out")
    parser.add_argument("--motions", nargs="+", choices=calibrate.MOTIONS, default=calibrate.MOTIONS)
    parser.add_argument(
        "--scenarios",
        nargs="+",
        choices=list(sigmas.SIGMA_SCENARIOS),
        default=list(sigmas.SIGMA_SCENARIOS),
        help="for `sigmas`",
    )
    parser.add_argument("--poses", type=int, default=1_000_000, help="length of the drive of `graph-incremental-scale`")
    return parser.parse_args()


def _graphs(arguments: argparse.Namespace, wanted: Sequence[str]) -> None:
    """Run the benchmarks of pose graphs with the systems that are there."""
    programs = {
        "heliograph": Path(sys.executable),
        "rivals": arguments.rival_bin / "python",
        "ceres": _ROOT / "build" / "ceres_pose_graph",
    }
    for name, program in programs.items():
        if not program.exists():
            print(f"{program} is not there: its solvers ({name}) are left out", file=sys.stderr)
    work = arguments.work / "graph"
    if "graph" in wanted:
        there = [s for s in graph.SOLVERS if programs.get(s.system, programs["rivals"]).exists()]
        folder = arguments.data.parent / "posegraphs"
        sources = {name: folder / f"{name}.g2o" for name in arguments.graphs or graph.GRAPHS}
        _write("graph", graph.compare(sources, there, work, programs, runs=arguments.runs or _RUNS["graph"]))
    if "graph-scale" in wanted:
        names = arguments.graphs or list(graph_scale.WORLDS)
        runs = arguments.runs or _RUNS["graph-scale"]
        _write("graph_scale", graph_scale.measure_scale(names, work, programs, runs=runs))
    if "graph-incremental" in wanted:
        names = arguments.graphs or graph_incremental.INCREMENTAL_GRAPHS
        runs, folder = arguments.runs or _RUNS["graph-incremental"], arguments.data.parent / "posegraphs"
        rows = graph_incremental.compare_incremental(folder, names, work, programs, runs=runs)
        _write("graph_incremental", rows)
    if "graph-outliers" in wanted:
        seeds, folder = range(200, 200 + (arguments.runs or _RUNS["graph-outliers"])), arguments.data.parent
        _write("graph_outliers", list(outliers.measure_outliers(folder / "posegraphs", seeds=seeds)))
    if "graph-incremental-scale" in wanted:
        count = arguments.poses
        _write("graph_incremental_scale", graph_incremental.measure_incremental_scale(work, programs, count=count))


def _clouds(arguments: argparse.Namespace, wanted: Sequence[str]) -> None:
    """Run the benchmarks of registration, degeneracy, sigmas, the k-d tree, LOAM, loops and localisation."""
    rival, work = arguments.rival_bin / "python", arguments.work / "clouds"

    def python_of(system: str) -> Path:
        return Path(sys.executable) if system == "heliograph" else rival

    if "registration" in wanted:
        rows = registration.compare_pairs(work, python_of, count=200, seed=97)
        pair = arguments.data.parent / "registration"
        if pair.exists():
            rows += registration.compare_starts(pair, work, python_of, starts=50)
        _write("registration", rows)
    if "global" in wanted:
        keyframes = arguments.data.parent / "keyframes"
        _write("global_alignment", global_alignment.compare_global(keyframes, work, python_of))
    if "blind" in wanted:
        _write("blind", [*blind.alarms(), *blind.remapping(), *blind.update_cost()])
    if "kd-tree" in wanted:
        _write("kd_tree", [*kd_tree.measure_trees(work, rival), *kd_tree.drive(), *kd_tree.in_filter()])
    if "sigmas" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["sigmas"]))
        _write("sigmas", list(sigmas.measure_sigmas(arguments.scenarios, seeds=seeds)))
    if "match-scores" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["match-scores"]))
        _write("match_scores", list(match_scores.measure_scores(list(match_scores.SCORE_SCENARIOS), seeds=seeds)))
    if "loam" in wanted:
        data = arguments.data if arguments.data.exists() else None
        rows = loam.compare_loam(_LOAM, data, work / "loam", rival)
        _write("loam", [*rows, *loam.sweep_loam(_LOAM[:2], None)])
    if "loops" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["loops"]))
        _write("loops", loops.measure_loops(arguments.data.parent / "keyframes", seeds=seeds))
        _write("loop_misled", loop_misled.measure_misled(seeds))
    if "localization" in wanted:
        _write("localization", localization_table.measure_localization(arguments.data.parent))


def _whole_runs(arguments: argparse.Namespace, wanted: Sequence[str], command: Path) -> None:
    """Run simulated ways that come back, and the demo with each variant, through the command."""
    if "loop-runs" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["loop-runs"]))
        rows = loop_runs.measure_loop_runs(loop_runs.LOOP_RUN_SCENARIOS, arguments.work / "loops", command, seeds=seeds)
        _write("loop_runs", rows)
    if "graph-sigmas" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["graph-sigmas"]))
        names = list(graph_sigmas.GRAPH_SIGMA_SCENARIOS)
        _write("graph_sigmas", graph_sigmas.measure_graph_sigmas(names, seeds=seeds))
    if "side-by-side" in wanted:
        _write("side_by_side", side_by_side.measure_demo(arguments.work / "side_by_side", command))


def _healthy(arguments: argparse.Namespace, wanted: Sequence[str]) -> None:
    """Run the benchmarks of what the checks say of sound recordings, and of silences."""
    if "healthy" in wanted:
        seeds = range(arguments.first, arguments.first + (arguments.runs or _RUNS["healthy"]))
        _write("healthy", list(healthy.measure_healthy(seeds)))
    if "outages" in wanted:
        first = arguments.first or 200
        _write("outages", outages.measure_outages(range(first, first + (arguments.runs or _RUNS["outages"]))))
    if "wheels" in wanted:
        first = arguments.first or 201
        _write("wheels", wheels.measure_wheels(range(first, first + (arguments.runs or _RUNS["wheels"]))))


def _timings(
    arguments: argparse.Namespace, wanted: Sequence[str], systems: Sequence[Adapter], bins: dict[str, Path]
) -> None:
    """Time the whole command beside its rivals, and a live stream, on one simulated recording."""
    if not {"speed", "live"} & set(wanted):
        return
    folder = arguments.simulated or speed.simulated(
        arguments.work / f"warehouse_{arguments.seconds:g}",
        bins["heliograph"] / "heliograph",
        seconds=arguments.seconds,
        seed=1,
    )
    if "speed" in wanted:
        _write("speed", speed.alternate(folder, systems, arguments.work, bins, runs=arguments.runs or _RUNS["speed"]))
    if "live" in wanted:
        _write("live", live.measure_latency(folder, threads=2))


def _pages(arguments: argparse.Namespace, wanted: Sequence[str], command: Path) -> None:
    """Time what people look at: the lab's answers, and the report of a long run in a browser."""
    if "lab" in wanted:
        _write("lab", lab.measure_lab())
    if "report-page" in wanted:
        runs = arguments.runs or _RUNS["report-page"]
        _write("report_page", report_page.measure_report_page(arguments.work, command, runs=runs))


def main() -> None:
    """Run what the command line asks for and write the table."""
    arguments = _parse()
    ours = Path(sys.executable).parent
    bins = dict.fromkeys(ADAPTERS, arguments.rival_bin) | {"heliograph": ours}
    chosen = [ADAPTERS[name] for name in arguments.systems or ADAPTERS]
    timed = [ADAPTERS[name] for name in arguments.systems or _TIMED]
    wanted = _ALL if arguments.benchmark == "all" else (arguments.benchmark,)
    if not arguments.data.exists():
        print(f"{arguments.data} is not there: {', '.join(_NEEDS_DATA)} are left out", file=sys.stderr)
        wanted = tuple(name for name in wanted if name not in _NEEDS_DATA)
    if "kitti" in wanted:
        _write("kitti", kitti.compare(arguments.data, chosen, arguments.work, bins))
    if "sharpness" in wanted:
        _write("sharpness", kitti.sharpness(arguments.data, ADAPTERS["heliograph"], arguments.work, bins))
    _timings(arguments, wanted, timed, bins)
    _pages(arguments, wanted, ours / "heliograph")
    if "start" in wanted:
        names, seeds = list(start.START_CASES), arguments.runs or _RUNS["start"]
        _write("start", start.compare_starts(arguments.work, ours / "heliograph", names=names, runs=seeds))
    _healthy(arguments, wanted)
    _whole_runs(arguments, wanted, ours / "heliograph")
    rival = arguments.rival_bin / "python"
    if "imu" in wanted:
        _write("imu", imu.measure(arguments.work, rival, runs=arguments.runs or _RUNS["imu"]))
    if "imu-gnss" in wanted:
        _write("imu_gnss", imu_gnss.compare(arguments.data.parent / "kitti_00", arguments.work, rival))
    if "lio" in wanted:
        folder, runs = arguments.data.parent / "kitti_00", arguments.runs or _RUNS["lio"]
        _write("lio", lio.compare(folder, arguments.work, rival, Path(sys.executable), runs=runs))
    if any(name.startswith("graph") for name in wanted):
        _graphs(arguments, wanted)
    _clouds(arguments, wanted)
    if "calibrate" in wanted:
        for motion in arguments.motions:
            seeds = range(arguments.first, arguments.first + arguments.trials)
            calibrate.run_trials(motion, seeds, _RESULTS / "calibrate.jsonl")
    table.write_table(_RESULTS, _ROOT / "benchmarks" / "BENCHMARKS.md")
    table.write_readme(_RESULTS, _ROOT / "README.md")


if __name__ == "__main__":
    main()
