"""Loops through `heliograph run`: what filter, graph and loops together make of ways that come back.

Each recording is simulated to a file, run with the public command and held against its exact truth: the odometry, and
the trajectory that the graph has the last word on.
"""

from __future__ import annotations

import csv
import json
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data import Trajectory
from heliograph.io import read_tum
from heliograph.lie import interpolate_se3, se3
from heliograph.metrics.trajectory import absolute_trajectory_error, associate
from heliograph.slam import KeyframeStore
from heliograph.slam.loops.ledger_file import read_ledger

__all__ = ["LOOP_RUN_SCENARIOS", "loop_runs_section", "measure_loop_runs", "score_run"]

LOOP_RUN_SCENARIOS = ("warehouse-laps", "campus", "storeys")
_RIGHT_M, _RIGHT_DEG = 0.5, 5.0
_NEAR_M, _NEAR_UP_M, _WAY_M = 4.0, 1.0, 30.0  # a keyframe comes back to a place so near, after so much of the way
_SPLIT = 10  # keyframes that come back to nothing between two groups of those that do


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """Accepted loops: keyframes, errors of their relative poses [m], [deg]; and the queries that were looked at."""

    queries: Array
    metres: Array
    degrees: Array
    looked_at: int

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def right(self) -> Array:
        """Which of them are right, (N,) bool."""
        return np.asarray((self.metres <= _RIGHT_M) & (self.degrees <= _RIGHT_DEG))


def measure_loop_runs(
    names: Sequence[str], work: Path, command: Path, *, seeds: Iterable[int], options: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Yield one row a recording, as it is done.

    Parameters
    ----------
    names : sequence of str
        Scenarios.
    work : Path
        Scratch folder; a recording that lies there already is used.
    command : Path
        The ``heliograph`` to run.
    seeds : iterable of int
    options : sequence of str
        More of `heliograph run`.
    """
    for seed in seeds:
        for name in names:
            folder, out = work / f"{name}_{seed}", work / f"{name}_{seed}_run"
            if not (folder / "recording.mcap").exists():
                subprocess.run([command, "simulate", name, "--seed", str(seed), "-o", folder, "-q"], check=True)
            run = ["run", folder / "recording.mcap", "-o", out, "--overwrite", "--threads", "1", "-q", *options]
            subprocess.run([command, *run], check=True)
            yield {"scenario": name, "seed": seed} | score_run(out, folder / "groundtruth_imu.tum")


def score_run(out: Path, truth: Path) -> dict[str, Any]:
    """Return what a run's folder holds against the true poses of its IMU, TUM rows.

    ATE after alignment [m]; gap: error of the way from the first pose to the last [m]; kink: most by which the
    trajectory's step from one scan to the next differs from the odometry's [m].
    """
    true = read_tum(truth)
    odometry, final = read_tum(out / "odometry.tum"), read_tum(out / "trajectory.tum")
    facts = json.loads((out / "run.json").read_text())
    store = KeyframeStore.open(out / "keyframes")
    T_true = _at(true, np.array([keyframe.stamp_ns for keyframe in store]))
    found = _loops(out, T_true)
    before, after = (absolute_trajectory_error(associate(one, true)) for one in (odometry, final))
    groups = _groups(T_true)
    right = set(found.queries[found.right].tolist())
    good = found.metres[found.right]
    with (out / "scans.csv").open(newline="") as file:
        ms = [float(row["ms_total"]) for row in csv.DictReader(file)]
    times = facts["timings"]
    return {
        "status": facts["status"], "scans": len(ms), "way_m": float(_way(T_true)[-1]),
        "keyframes": len(store), "looked_at": found.looked_at, "accepted": len(found.queries),
        "false": int((~found.right).sum()), "groups": len(groups),
        "closed": sum(bool(group & right) for group in groups),
        "loop_median_m": float(np.median(good)) if len(good) else None,
        "loop_p90_m": float(np.quantile(good, 0.9)) if len(good) else None,
        "loop_median_deg": float(np.median(found.degrees[found.right])) if len(good) else None,
        "ate_odometry_m": before.rmse, "ate_m": after.rmse, "max_odometry_m": before.max, "max_m": after.max,
        "turn_odometry_deg": before.rotation_rmse_deg, "turn_deg": after.rotation_rmse_deg,
        "gap_odometry_m": _gap(odometry, true), "gap_m": _gap(final, true), "kink_m": _kink(odometry, final),
        "ms_p50": float(np.median(ms)), "ms_p99": float(np.quantile(ms, 0.99)),
        "graph_share": times.get("graph_s", 0.0) / times["wall_s"], "memory_mb": facts["peak_memory_mb"],
    }  # fmt: skip


def _at(true: Trajectory, stamps: Array) -> Array:
    return np.asarray(interpolate_se3(true.stamps_ns, true.T_frame_body, stamps, extrapolate=True))


def _loops(out: Path, T_true: Array) -> _Found:
    ledger = read_ledger(out / "loops.csv")
    accepted = [entry.evidence for entry in ledger.accepted()]
    off = [se3.log(se3.inverse(se3.inverse(T_true[e.match]) @ T_true[e.query]) @ e.T_match_query) for e in accepted]
    d = np.array(off).reshape(-1, 6)
    return _Found(
        queries=np.array([e.query for e in accepted], dtype=np.int64),
        metres=np.linalg.norm(d[:, 3:], axis=1),
        degrees=np.degrees(np.linalg.norm(d[:, :3], axis=1)),
        looked_at=len({entry.evidence.query for entry in ledger}),
    )


def _way(T: Array) -> Array:
    """Return the way up to each pose (K,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))])


def _groups(T_true: Array) -> list[set[int]]:
    """Return the keyframes that come back to a place, those of one revisit together."""
    p = T_true[:, :3, 3]
    way = _way(T_true)
    groups: list[set[int]] = []
    last = -1 - _SPLIT
    for k in range(len(p)):
        old = way < way[k] - _WAY_M
        near = (np.linalg.norm(p[old, :2] - p[k, :2], axis=1) < _NEAR_M) & (np.abs(p[old, 2] - p[k, 2]) < _NEAR_UP_M)
        if near.any():
            if k - last > _SPLIT:
                groups.append(set())
            groups[-1].add(k)
            last = k
    return groups


def _gap(estimate: Trajectory, true: Trajectory) -> float:
    """Error of the way from the first pose to the last [m]."""
    ends = estimate.stamps_ns[[0, -1]]
    (a, b), (x, y) = estimate.T_frame_body[[0, -1]], _at(true, ends)
    return float(np.linalg.norm((se3.inverse(a) @ b)[:3, 3] - (se3.inverse(x) @ y)[:3, 3]))


def _kink(odometry: Trajectory, final: Trajectory) -> float:
    steps = [se3.inverse(T[:-1]) @ T[1:] for T in (odometry.T_frame_body, final.T_frame_body)]
    if len(steps[0]) != len(steps[1]) or not len(steps[0]):
        return float("nan")
    return float(np.linalg.norm(steps[1][:, :3, 3] - steps[0][:, :3, 3], axis=1).max())


def loop_runs_section(rows: Sequence[dict[str, Any]], table: Callable[[list[str], list[list[str]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = [
        "scenario", "seed", "way", "keyframes", "looked at", "accepted", "false", "revisits closed", "loop error",
        "ATE odometry", "ATE", "gap odometry", "gap", "kink", "ms a scan", "p99", "graph's share", "MB", "status",
    ]  # fmt: skip
    body = [
        [
            r["scenario"], str(r["seed"]), f"{r['way_m']:.0f} m", str(r["keyframes"]), str(r["looked_at"]),
            str(r["accepted"]), str(r["false"]), f"{r['closed']} of {r['groups']}",
            "-" if r["loop_median_m"] is None else f"{1e3 * r['loop_median_m']:.0f} mm, {r['loop_median_deg']:.2f} deg",
            *(f"{1e3 * r[key]:.1f} mm" for key in ("ate_odometry_m", "ate_m", "gap_odometry_m", "gap_m", "kink_m")),
            f"{r['ms_p50']:.0f}", f"{r['ms_p99']:.0f}", f"{100 * r['graph_share']:.1f} %", f"{r['memory_mb']:.0f}",
            r["status"],
        ]
        for r in rows
    ]  # fmt: skip
    return "\n".join([
        "## Loops through the command", "",
        "Simulated recordings through `heliograph run` on one thread of a machine with other work on it: odometry "
        "beside the trajectory on which graph and loops have the last word. Looked at are the keyframes at which a "
        "loop could tell more than odometry knows; a revisit is a stretch of keyframes within 4 m of one at least 30 m "
        "of way before. A loop is false beyond 0.5 m or 5 degrees; its error is the median of the right ones. Gap: "
        "error of the way from the first pose to the last. Kink: most by which the trajectory's step from scan to scan "
        "differs from the odometry's.",
        "", table(head, body), "",
    ])  # fmt: skip
