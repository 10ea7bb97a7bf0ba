"""The folder that a localisation leaves: where each scan was in the map, and an account of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from heliograph.atomic import check_output_directory, output_errors, write_text
from heliograph.data import ScanResult
from heliograph.io.files.clouds import write_cloud
from heliograph.io.files.tum import TumWriter
from heliograph.lie import so3
from heliograph.localization.changes import Changes
from heliograph.localization.localizer import Localizer
from heliograph.localization.records import Localization, LocalizationState
from heliograph.output.lock import FolderLock
from heliograph.output.manifest import hashed_files
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary, fold_events

__all__ = ["COLUMNS", "LOCALIZATION_SCHEMA", "LocalizationFolder"]

LOCALIZATION_SCHEMA = "heliograph localization 1"
"""Schema of ``run.json``: names may be added, none changes or goes."""

COLUMNS = (
    "stamp_ns", "state", "places", "x", "y", "z", "qx", "qy", "qz", "qw",
    "sigma_rx", "sigma_ry", "sigma_rz", "sigma_x", "sigma_y", "sigma_z",
    "matched", "nis", "seen_through", "seconds",
)  # fmt: skip
"""Columns of ``localization.csv``: x to qw are ``T_map_odom``, the sigmas those of ``T_map_imu``."""

_FILES = ("trajectory.tum", "odometry.tum", "localization.csv", "changes.ply", "config.toml", "run.json")
_MOSTLY = 0.9  # share of the scans after the first lock that must be localised in a result that is well


class LocalizationFolder(Sink):
    """Localises each result of a run and writes what comes of it.

    Parameters
    ----------
    path : Path
        The folder; made if absent.
    make : callable
        Makes the `Localizer`; once more where a recording begins anew.
    name : str
        The recording's name.
    config : str
        The resolved configuration as TOML.
    facts : callable
        Returns what ``run.json`` says besides (map, recording, versions).
    overwrite : bool
        Replace an earlier one.

    Raises
    ------
    OutputError
        The folder is not empty, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        make: Callable[[], Localizer],
        *,
        name: str,
        config: str,
        facts: Callable[[], Mapping[str, Any]] = dict,
        overwrite: bool = False,
    ) -> None:
        self.path = check_output_directory(path, overwrite)
        self._lock = FolderLock(path)
        self.name, self._make, self._facts = name, make, facts
        self.facts: dict[str, Any] = {}
        for file in _FILES:
            (path / file).unlink(missing_ok=True)
        write_text(path / "config.toml", config)
        write_text(path / "run.json", json.dumps({"status": "running"}) + "\n")
        self._begin()

    def _begin(self) -> None:
        self.localizer = self._make()
        head = "T_{0}_imu (p_{0} = T p_imu), stamp = header stamp of a LiDAR message [s], x y z [m] qx qy qz qw"
        self._map = TumWriter(self.path / "trajectory.tum", f"heliograph: {head.format('map')}")
        self._odom = TumWriter(self.path / "odometry.tum", f"heliograph: {head.format('odom')}")
        with output_errors(self.path):
            self._table: TextIO = (self.path / "localization.csv").open("w", encoding="utf-8", newline="\n")
            self._table.write(",".join(COLUMNS) + "\n")
        self._spans = _Spans()

    def restart(self) -> None:
        """Begin anew; what was written is gone."""
        self._release()
        self._begin()

    def add(self, result: ScanResult) -> None:
        """Localise a result and write its row."""
        found = self.localizer.add(result)
        self._spans.add(found)
        self._odom.append(result.header_stamp_ns, result.T_odom_imu_header)
        if found.T_map_imu_header is not None:
            self._map.append(result.header_stamp_ns, found.T_map_imu_header)
        with output_errors(self.path):
            self._table.write(_row(found) + "\n")

    def close(self, summary: RunSummary) -> None:
        """Complete the files."""
        self._release()
        events = fold_events((*summary.events, *self.localizer.events))
        changes = self.localizer.changes.changes()
        if len(changes.gone) + len(changes.new):
            points = np.ascontiguousarray(np.concatenate([changes.gone, changes.new]))
            write_cloud(
                self.path / "changes.ply",
                points,
                np.repeat([0.0, 1.0], [len(changes.gone), len(changes.new)]).astype(np.float32),
            )
        files = [name for name in _FILES if name == "run.json" or (self.path / name).exists()]
        self.facts = {
            "schema": LOCALIZATION_SCHEMA,
            **self._spans.facts(self.localizer, summary),
            "changes": _change_facts(changes),
            "warnings": [
                {"code": e.code, "severity": e.severity, "message": e.message, "count": e.count} for e in events
            ],
            **self._facts(),
            "folder": str(self.path),
            "files": files,
            "outputs": hashed_files(self.path / name for name in files if name != "run.json"),
        }
        write_text(self.path / "run.json", json.dumps(self.facts, indent=2, allow_nan=False) + "\n")
        self._lock.release()

    def _release(self) -> None:
        self._map.close()
        self._odom.close()
        self._table.close()


class _Spans:
    """States in intervals, and what they come to."""

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self._scans: dict[LocalizationState, int] = {"localised": 0, "ambiguous": 0, "not localised": 0}
        self._since_lock = 0
        self._begin_ns: int | None = None
        self._lock_s: float | None = None
        self._seconds: list[float] = []

    def add(self, found: Localization) -> None:
        self._begin_ns = found.stamp_ns if self._begin_ns is None else self._begin_ns
        if self._lock_s is None and found.state == "localised":
            self._lock_s = 1e-9 * (found.stamp_ns - self._begin_ns)
        self._since_lock += self._lock_s is not None
        self._scans[found.state] += 1
        if found.state == "localised":
            self._seconds.append(found.seconds)
        last = self._rows[-1] if self._rows else None
        if last is None or last["state"] != found.state:
            last = {"state": found.state, "begin_ns": found.stamp_ns, "scans": 0, "places": 0}
            self._rows.append(last)
        last["end_ns"], last["scans"] = found.stamp_ns, last["scans"] + 1
        last["places"] = max(last["places"], found.places)

    def facts(self, localizer: Localizer, summary: RunSummary) -> dict[str, Any]:
        total = sum(self._scans.values())
        share = self._scans["localised"] / max(self._since_lock, 1)
        status, reasons = self._judged(share)
        queries = localizer.queries or [0.0]
        return {
            "status": status,
            "reasons": reasons,
            "interrupted": summary.interrupted,
            "failure": summary.failure,
            "scans": total,
            "scans_by_state": dict(self._scans),
            "first_lock_s": self._lock_s,
            "localised_share_after_lock": share,
            "states": self._rows,
            "queries": len(localizer.queries),
            "query_ms": {"mean": 1e3 * float(np.mean(queries)), "max": 1e3 * float(np.max(queries))},
            "tracking_ms": 1e3 * float(np.mean(self._seconds)) if self._seconds else None,
            "odometry_ms": float(sum(summary.stage_ms.values())),
            "submaps": len(localizer.saved),
            "distance_m": summary.distance,
            "duration_s": summary.duration,
        }

    def _judged(self, share: float) -> tuple[str, list[str]]:
        if self._lock_s is None:
            several = max((row["places"] for row in self._rows), default=0)
            if self._scans["ambiguous"]:
                return "lost", [f"up to {several} places of the map fit alike to the end: go on to where they differ"]
            return "lost", [
                "no place of the map fits the scans: is it a map of another place, of another scale, or has the scene "
                "changed too much?"
            ]
        if share < _MOSTLY:
            return "degraded", [f"only {share:.0%} of the scans after the first lock are localised"]
        return "ok", []


def _change_facts(changes: Changes) -> dict[str, Any]:
    return {
        "gone_points": len(changes.gone),
        "new_points": len(changes.new),
        "submaps": [
            {"submap": s.index, "position": s.position.tolist(), "looked_at": s.looked_at, "gone_share": s.gone}
            for s in changes.submaps
        ],
    }


def _row(found: Localization) -> str:
    words = [str(found.stamp_ns), found.state, str(found.places)]
    if found.T_map_odom is None or found.sigma is None:
        words += [""] * 13
    else:
        quaternion = so3.to_quaternion(found.T_map_odom[:3, :3])
        words += [f"{x:.9g}" for x in (*found.T_map_odom[:3, 3], *quaternion, *found.sigma)]
    numbers = (found.matched, found.nis, found.seen_through, found.seconds)
    return ",".join(words + ["" if np.isnan(x) else f"{x:.6g}" for x in numbers])
