"""Latency of a live stream: from the message that completes a scan to its result, in process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.config import RunConfig
from heliograph.io import open_recording
from heliograph.odometry import make_odometry

__all__ = ["live_section", "measure_latency"]


def measure_latency(recording: Path, *, threads: int) -> list[dict[str, Any]]:
    """Return one row: quantiles of the time that the completing message takes, the call with the first result apart."""
    with open_recording(recording) as opened:
        rig, messages = opened.rig, list(opened.stream())
    odometry = make_odometry(RunConfig(), rig, frozenset({"lidar", "imu"}), threads)
    taken, first = [], None
    for message in messages:
        wall, cpu = time.perf_counter(), time.process_time()
        results = odometry.add(message)
        spent = 1e3 * np.array([time.perf_counter() - wall, time.process_time() - cpu])
        if results and first is None:
            first = spent
        elif results:
            taken.append(spent)
    times = np.array(taken)
    row: dict[str, Any] = {"benchmark": "live", "scans": len(times), "threads": threads}
    for name, values in zip(("wall", "cpu"), times.T, strict=True):
        for q in (50, 99, 100):
            row[f"{name}_ms_{q}"] = float(np.quantile(values, q / 100))
    row["first_wall_ms"], row["first_cpu_ms"] = (first if first is not None else np.full(2, np.nan)).tolist()
    return [row]


def live_section(rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Sequence[Any]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = ["threads", "clock", "median ms", "p99 ms", "max ms", "call with the first result ms"]
    body = [
        [r["threads"], clock, *(f"{r[f'{clock}_ms_{q}']:.1f}" for q in (50, 99, 100)), f"{r[f'first_{clock}_ms']:.0f}"]
        for r in rows
        for clock in ("wall", "cpu")
    ]
    worst = max(r["wall_ms_99"] for r in rows)
    verdict = "kept" if worst <= 15.0 else "missed"
    return (
        f"## Live: from the completing message to the result\n\n{table(head, body)}\n"
        f"Simulated warehouse, {rows[0]['scans']} scans of 64 x 1024 in process. Bar: p99 of 15 ms by the wall clock; "
        f"{verdict}. The call with the first result does the start and all scans since; `LiveOdometry` does it beside "
        "the driver.\nThe wall clock is worth something only where nothing else runs.\n"
    )
