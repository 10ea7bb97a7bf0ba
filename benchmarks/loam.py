"""LOAM beside the filter and, where its wheel is there, evalio's LOAM and LIO-SAM; and what each of its settings does.

All in process and on one thread: milliseconds are processor time of the estimation a scan, without reading and writing.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.accuracy import accuracy
from heliograph.config import LoamConfig, RunConfig
from heliograph.data import ImuBatch, Message, Rig, Scan, Trajectory
from heliograph.io import open_recording, read_tum
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, Scenario, simulate
from heliograph.sim.trajectory import Gait

__all__ = ["compare_loam", "loam_section", "sweep_loam"]

_Rows = list[dict[str, Any]]
_SYSTEMS = (("filter", "lidar,imu"), ("loam", "lidar,imu"), ("filter", "lidar"), ("loam", "lidar"))
_SHAKEN = Gait(frequency=1.1, bounce=0.08, lateral=0.10, roll_deg=18.0, pitch_deg=14.0, yaw_deg=22.0)

LOAM_WORLDS: MappingProxyType[str, tuple[Scenario, int]] = MappingProxyType(
    {
        "walk": (SCENARIOS["demo"].thinned(columns=1024, duration=40.0), 3),
        "shake": (replace(SCENARIOS["demo"], gait=_SHAKEN).thinned(columns=1024, duration=40.0), 4),
        "warehouse": (SCENARIOS["warehouse"].thinned(duration=60.0), 5),
        **{name: (SCENARIOS[name].thinned(duration=20.0), 1) for name in ("traffic", "forest", "rough")},
    }
)
"""Worlds with their seeds, none of which the settings were chosen on: those are 1 and 2 of walks in the hall."""

SWEPT: MappingProxyType[str, tuple[float, ...]] = MappingProxyType(
    {
        "features.edge_curvature": (0.005, 0.01, 0.02, 0.04),
        "features.plane_curvature": (0.0025, 0.005, 0.01),
        "features.edges": (0, 1, 2, 4),
        "features.planes": (2, 4, 8),
        "features.map_stride": (2, 5, 10),
        "features.window": (3, 5, 8),
        "neighbours": (5, 8, 12),
        "edge_voxel": (0.2, 0.3, 0.5),
        "plane_voxel": (0.2, 0.4, 0.8),
        "passes": (1, 2),
    }
)
"""Values of each setting, the others at their defaults."""


def configured(changes: dict[str, float]) -> LoamConfig:
    """Return LOAM's settings with some of them changed, by name."""
    features = {k.removeprefix("features."): v for k, v in changes.items() if k.startswith("features.")}
    config = replace(LoamConfig(), **{k: v for k, v in changes.items() if not k.startswith("features.")})
    return replace(config, features=replace(config.features, **features))


def followed(
    records: Iterable[Message], rig: Rig, config: RunConfig, sensors: str = "lidar,imu"
) -> tuple[Trajectory, float, dict[str, int]]:
    """Return the IMU's path, milliseconds of processor time a scan, and how many scans have which status."""
    names = frozenset(sensors.split(","))
    odometry, taken, results = make_odometry(config, rig, names, 1), 0.0, []
    for record in records:
        begin = time.process_time()
        found = odometry.add(record)
        taken += time.process_time() - begin
        results += [replace(r, points_imu=r.points_imu[:0], intensity=None) for r in found]
    results += odometry.finish()
    counts: dict[str, int] = {}
    for r in results:
        counts[r.status] = counts.get(r.status, 0) + 1
    path = Trajectory(
        stamps_ns=np.array([r.end_ns for r in results]), T_frame_body=np.stack([r.T_odom_imu for r in results])
    )
    return path, 1e3 * taken / max(len(results), 1), counts


def worlds(names: Sequence[str], kitti: Path | None) -> dict[str, Callable[[], tuple[list[Message], Rig, Trajectory]]]:
    """Return, for each world, what makes its messages, mounting and truth."""

    def simulated(name: str) -> tuple[list[Message], Rig, Trajectory]:
        scenario, seed = LOAM_WORLDS[name]
        drive = simulate(scenario, seed)
        records = list(drive)
        ends = np.array([r.end_ns for r in records if isinstance(r, Scan)])
        return records, drive.rig, Trajectory(stamps_ns=ends, T_frame_body=drive.truth.pose(ends))

    def recorded() -> tuple[list[Message], Rig, Trajectory]:
        assert kitti is not None
        with open_recording(kitti / "recording") as recording:
            return list(recording.stream()), recording.rig, read_tum(kitti / "groundtruth_imu.tum")

    made: dict[str, Callable[[], tuple[list[Message], Rig, Trajectory]]] = {
        name: (lambda name=name: simulated(name)) for name in names if name in LOAM_WORLDS
    }
    return made | ({"kitti_0005": recorded} if kitti is not None and "kitti_0005" in names else {})


def compare_loam(names: Sequence[str], kitti: Path | None, work: Path, rival: Path) -> _Rows:
    """Return one row a world and system."""
    rows: _Rows = []
    for name, make in worlds(names, kitti).items():
        records, rig, truth = make()
        for system, sensors in _SYSTEMS:
            path, ms, counts = followed(records, rig, RunConfig(odometry=system), sensors)
            rows.append(_row(name, system, sensors, path, truth, ms) | {"statuses": counts})
            print(rows[-1], flush=True)
        if rival.exists() and name != "kitti_0005":
            rows += _rivals(name, records, rig, truth, work, rival)
    return rows


def sweep_loam(names: Sequence[str], kitti: Path | None) -> _Rows:
    """Return one row a world, setting and value."""
    rows: _Rows = []
    for name, make in worlds(names, kitti).items():
        records, rig, truth = make()
        for setting, values in SWEPT.items():
            for value in values:
                config = RunConfig(odometry="loam", loam=configured({setting: value}))
                path, ms, _ = followed(records, rig, config)
                rows.append(_row(name, "loam", "lidar,imu", path, truth, ms) | {"setting": setting, "value": value})
                print(rows[-1], flush=True)
    return rows


def _row(name: str, system: str, sensors: str, path: Trajectory, truth: Trajectory, ms: float) -> dict[str, Any]:
    errors = accuracy(path, truth)
    return {
        "benchmark": "loam", "world": name, "system": system, "sensors": sensors, "poses": errors.poses,
        "ate_m": errors.ate_m, "ate_max_m": errors.ate_max_m, "rpe_rotation_deg": errors.rpe_rotation_deg,
        "shift_ms": errors.shift_ms, "cpu_ms": ms,
    }  # fmt: skip


def _rivals(name: str, records: list[Message], rig: Rig, truth: Trajectory, work: Path, rival: Path) -> _Rows:
    work.mkdir(parents=True, exist_ok=True)
    drive, rows = work / f"{name}.npz", []
    _export(drive, records, rig)
    for system in ("LOAM", "LioSAM"):
        out = work / f"{name}_{system}.npz"
        worker = Path(__file__).with_name("evalio_worker.py")
        done = subprocess.run([str(rival), str(worker), system, str(drive), str(out)], check=False)
        if done.returncode != 0:
            continue
        found = np.load(out)
        stamps, first = np.unique(found["stamps_ns"], return_index=True)
        path = Trajectory(stamps_ns=stamps, T_frame_body=found["T"][first])
        ms = 1e3 * float(found["seconds"]) / int(found["scans"])
        sensors = "lidar,imu" if system == "LioSAM" else "lidar"
        # Poses are of the scan's start, middle or end, as the system likes: the shift that suits it is found as always.
        rows.append(_row(name, f"evalio {system}", sensors, path, truth, ms))
        print(rows[-1], flush=True)
    return rows


def _export(file: Path, records: list[Message], rig: Rig) -> None:
    """Write a drive as arrays: clouds as images of (rows, columns), a missing return as zeros."""
    scans = [record for record in records if isinstance(record, Scan)]
    imu = ImuBatch.joined([record for record in records if isinstance(record, ImuBatch)])
    rows = 1 + max(int(scan.ring.max()) for scan in scans if scan.ring is not None)
    times = np.unique(np.concatenate([scan.offsets_ns for scan in scans]))
    dtype = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4"), ("row", "<u2"), ("col", "<u2")]
    clouds = np.zeros((len(scans), rows, len(times)), dtype)
    clouds["t"], clouds["col"], clouds["row"] = times, np.arange(len(times)), np.arange(rows)[:, None]
    for cloud, scan in zip(clouds, scans, strict=True):
        at = (scan.ring, np.searchsorted(times, scan.offsets_ns))
        for axis, values in zip("xyz", scan.points.T, strict=True):
            cloud[axis][at] = values
    np.savez(
        file, clouds=clouds, starts_ns=[scan.stamp_ns for scan in scans], shape=[rows, len(times)],
        imu_ns=imu.stamps_ns, gyro=imu.gyro, accel=imu.accel, T_imu_lidar=rig.T_imu_lidar,
        imu_rate=1e9 / np.median(np.diff(imu.stamps_ns)),
    )  # fmt: skip


def _tracked(row: dict[str, Any]) -> str:
    counts = row.get("statuses")
    if not counts:
        return "-"
    sure = sum(counts.get(name, 0) for name in ("first", "tracked", "degenerate"))
    return f"{100 * sure / sum(counts.values()):.0f} %"


def loam_section(rows: _Rows, table: Callable[[Sequence[str], Sequence[Sequence[Any]]], str]) -> str:
    """Return the section of BENCHMARKS.md."""
    head = ["world", "system", "sensors", "ATE mm", "max mm", "RPE deg", "cpu ms a scan", "tracked"]
    body = [
        [r["world"], r["system"], r["sensors"], f"{1e3 * r['ate_m']:.1f}", f"{1e3 * r['ate_max_m']:.1f}",
         f"{r['rpe_rotation_deg']:.3f}", f"{r['cpu_ms']:.1f}", _tracked(r)]
        for r in rows if "setting" not in r
    ]  # fmt: skip
    text = "## LOAM\n\n" + table(head, body)
    text += (
        "\nEstimation alone, in process, one thread; worlds and seeds that no setting was chosen on, and KITTI raw "
        "0005. Tracked: share of the scans with that status or `degenerate`; a run is `degraded` below 90 %, `lost` "
        "from a tenth lost on. evalio's pipelines get the same points and samples, with their defaults; they tell no "
        "status.\n"
    )
    swept = [r for r in rows if "setting" in r]
    if swept:
        names = list(dict.fromkeys(r["world"] for r in swept))
        found = {(r["setting"], r["value"], r["world"]): r for r in swept}
        lines = []
        for setting, values in SWEPT.items():
            for value in values:
                cells = [found.get((setting, value, name)) for name in names]
                shown = [f"{1e3 * c['ate_m']:.1f} / {c['cpu_ms']:.1f}" if c else "-" for c in cells]
                default = configured({setting: value}) == LoamConfig()
                lines.append([f"`{setting}`", f"**{value:g}**" if default else f"{value:g}", *shown])
        text += "\nEach setting with the others at their defaults (bold), ATE mm / cpu ms a scan:\n\n"
        text += table(["setting", "value", *names], lines)
    return text
