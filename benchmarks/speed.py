"""Wall time of the whole command, bag in and files out, on a simulated warehouse: 64 x 1024 points at 10 Hz.

Runs alternate between the systems, so that whatever else the machine does falls on all of them alike. Heliograph writes
trajectories, map, log and report; its rivals write a trajectory.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import statistics
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy import accuracy, in_imu_frame
from benchmarks.process import Cost, measure, version_of
from benchmarks.rivals import Adapter, Job
from heliograph.data import Trajectory
from heliograph.io import open_recording, read_tum

__all__ = ["alternate", "busy_section", "simulated"]


def simulated(folder: Path, program: Path, *, seconds: float, seed: int) -> Path:
    """Return the simulated recording, made first if it is not there."""
    if not (folder / "recording.mcap").exists():
        command = [str(program), "simulate", "warehouse", "-o", str(folder), "--seed", str(seed), "--threads", "2"]
        subprocess.run([*command, "--duration", str(seconds), "--overwrite", "--quiet"], check=True)
    return folder


def alternate(
    recording: Path, adapters: Sequence[Adapter], work: Path, bins: dict[str, Path], *, runs: int, cores: int = 2
) -> list[dict[str, Any]]:
    """Run every system `runs` times in turn and return one row each: medians, and the accuracy of the last run."""
    opened = open_recording(recording)
    T_imu_lidar, lidar_topic = opened.rig.T_imu_lidar, _topic(opened.inferences)
    costs: dict[str, list[Cost]] = {a.name: [] for a in adapters}
    jobs: dict[str, Job] = {}
    for turn in range(runs):
        for adapter in adapters:
            out = work / f"speed_{adapter.name}"
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir(parents=True)
            jobs[adapter.name] = job = Job(
                recording=recording, lidar_topic=lidar_topic, out=out, bin=bins[adapter.name], cores=cores
            )
            log = work / f"speed_{adapter.name}.log"
            cost = measure(adapter.command(job), log=log, environment=adapter.environment(job), cores=cores)
            costs[adapter.name].append(cost)
            print(f"turn {turn + 1}: {adapter.name} {cost.wall_s:.1f} s wall, {cost.cpu_s:.1f} s processor", flush=True)
    truth = read_tum(recording / "groundtruth_imu.tum")
    scans = len(adapters[0].trajectory(jobs[adapters[0].name]))
    return [
        _row(a, costs[a.name], a.trajectory(jobs[a.name]), truth, T_imu_lidar, scans, jobs[a.name]) for a in adapters
    ]


def _row(
    adapter: Adapter,
    costs: list[Cost],
    reported: Trajectory,
    truth: Trajectory,
    T_imu_lidar: Any,  # noqa: ANN401
    scans: int,
    job: Job,
) -> dict[str, Any]:
    path = in_imu_frame(reported, T_imu_lidar)
    errors = accuracy(path, truth)
    # The frame that an adapter claims is checked: read as the other sensor's, the poses must fit the truth worse.
    mistaken = dataclasses.replace(reported, body="lidar" if reported.body == "imu" else "imu")
    return {
        "benchmark": "speed_warehouse",
        "system": adapter.name,
        "version": version_of(adapter.package, job.bin),
        "sensors": adapter.sensors,
        "runs": len(costs),
        "scans": scans,
        "wall_s": statistics.median(c.wall_s for c in costs),
        "wall_s_all": [round(c.wall_s, 2) for c in costs],
        "wall_ms_per_scan": 1e3 * statistics.median(c.wall_s for c in costs) / scans,
        "cpu_ms_per_scan": 1e3 * statistics.median(c.cpu_s for c in costs) / scans,
        "writers_ms_per_scan": _writers(job),
        "peak_mb": max(c.peak_mb for c in costs),
        **dataclasses.asdict(errors),
        "ate_as_other_body_m": accuracy(in_imu_frame(mistaken, T_imu_lidar), truth).ate_m,
    }


def _writers(job: Job) -> float | None:
    """Return what Heliograph's own account says of its writers; the rivals give none."""
    file = job.out / "run" / "run.json"
    if not file.exists():
        return None
    account = json.loads(file.read_text())
    return 1e3 * float(account["timings"]["writing_s"]) / int(account["scans"])


def _topic(inferences: Sequence[Any]) -> str:
    return next(str(i.value) for i in inferences if i.name == "lidar topic")


def busy_section(rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Sequence[Any]]], str]) -> str:
    """Return the section on a measurement that shared its machine with other work: processor time and memory only."""
    head = ["system", "scans", "runs", "cpu ms a scan", "peak MB", "ATE mm"]
    body = [
        [f"{r['system']} {r['version']}", r["scans"], r["runs"], f"{r['cpu_ms_per_scan']:.1f}", f"{r['peak_mb']:.0f}",
         f"{1e3 * r['ate_m']:.1f}"]
        for r in rows
    ]  # fmt: skip
    by = {r["system"]: r for r in rows}
    ours, theirs = by["heliograph"], by["rko-lio"]
    return (
        "## The same command, a shorter recording, a busy machine\n\n"
        + table(head, body)
        + "\nMeasured later than the table above, with everything that has come since, taken in turn beside other work "
        "that kept both cores busy several times over: the wall clock says nothing then, and processor time is higher "
        "than on a quiet machine for both. Ours over rko-lio's: processor time "
        f"{ours['cpu_ms_per_scan'] / theirs['cpu_ms_per_scan']:.2f} (bar: 0.5, missed), memory "
        f"{ours['peak_mb']:.0f} MB (bar: 110, {'kept' if ours['peak_mb'] <= 110 else 'missed'}).\n"
    )
