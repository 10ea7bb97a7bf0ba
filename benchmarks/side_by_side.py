"""One recording through the public command: the filter alone, with the graph behind it, and LOAM."""

from __future__ import annotations

import csv
import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["VARIANTS", "measure_demo", "measure_side_by_side", "side_by_side_section"]

VARIANTS = {"filter": ("--no-graph",), "filter + graph": (), "loam": ("--odometry", "loam")}
"""Options of `heliograph run` by name."""


def measure_demo(work: Path, command: Path) -> list[dict[str, Any]]:
    """Simulate the demo recording, the one of `heliograph demo`, and measure it."""
    folder = work / "demo"
    if not (folder / "recording.mcap").exists():
        subprocess.run([command, "simulate", "demo", "--seed", "1", "-o", folder, "-q"], check=True)
    return measure_side_by_side(folder / "recording.mcap", folder / "groundtruth_imu.tum", work, command)


def measure_side_by_side(recording: Path, truth: Path, work: Path, command: Path) -> list[dict[str, Any]]:
    """Run a recording once with each variant, on one thread.

    Parameters
    ----------
    recording, truth : Path
        A recording, and the true poses of its IMU as TUM rows.
    work : Path
        Scratch folder.
    command : Path
        The ``heliograph`` to run.
    """
    rows = []
    for name, options in VARIANTS.items():
        out = work / name.replace(" ", "")
        run = ["run", str(recording), "-o", str(out), "--overwrite", "--threads", "1", "-q", *options]
        subprocess.run([command, *run], check=True)
        found = subprocess.run(
            [command, "evaluate", out / "trajectory.tum", truth, "--json"], check=True, capture_output=True, text=True
        )
        rows.append(_row(name, out, json.loads(found.stdout)))
    return rows


def _row(name: str, out: Path, found: dict[str, Any]) -> dict[str, Any]:
    facts = json.loads((out / "run.json").read_text())
    with (out / "scans.csv").open(newline="") as file:
        ms = [float(row["ms_total"]) for row in csv.DictReader(file)]
    times = facts["timings"]
    return {
        "variant": name, "scans": len(ms), "ms_p50": float(np.median(ms)), "ms_p99": float(np.quantile(ms, 0.99)),
        "ate_m": found["absolute"]["rmse"], "gap_m": facts["start_end_gap_m"], "memory_mb": facts["peak_memory_mb"],
        "graph_share": times.get("graph_s", 0.0) / times["wall_s"], "status": facts["status"],
    }  # fmt: skip


def side_by_side_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[str]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = ["variant", "scans", "ms a scan", "p99", "ATE", "start-end gap", "MB", "graph's share of the run", "status"]
    body = [
        [
            r["variant"], str(r["scans"]), f"{r['ms_p50']:.0f}", f"{r['ms_p99']:.0f}", f"{1e3 * r['ate_m']:.1f} mm",
            f"{r['gap_m']:.3f} m", f"{r['memory_mb']:.0f}", f"{100 * r['graph_share']:.1f} %", r["status"],
        ]
        for r in rows
    ]  # fmt: skip
    return "\n".join([
        "## Filter, graph, LOAM", "",
        "The demo recording (one lap of 40 m, 33 s) through `heliograph run` on one thread of a machine with other "
        "work on it: times by the clock. The walk ends where it began, but for some millimetres. `python -m benchmarks "
        "side-by-side`.",
        "", table(head, body), "",
    ])  # fmt: skip
