"""First and last words of the report: how accurate the run is, what the recording held, which files there are."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from heliograph.output.georeference import gnss_facts
from heliograph.output.record import RunRecord

__all__ = ["accuracy", "files_beside", "streams"]

_STREAMS = {"lidar": "LiDAR", "imu": "IMU", "gnss": "GNSS", "wheels": "wheels"}
_FAULTS = ("gaps", "duplicates", "rewinds", "late", "unordered", "unusable", "empty")
_FILES = {
    "map.ply": "the map", "map.pcd": "the map", "map.laz": "the map", "map.png": "the map from above",
    "trajectory.tum": "poses", "trajectory_imu_rate.tum": "poses at the IMU's rate",
    "odometry.tum": "poses before loops",
    "scans.csv": "every scan", "loops.csv": "every candidate for a loop", "gnss.csv": "every fix",
    "graph.g2o": "poses and loops", "graph.npz": "the whole graph", "config.toml": "every setting",
}  # fmt: skip


def accuracy(record: RunRecord) -> str:
    """Return how accurate the result is, in three sentences: along the way, on Earth, and against gravity."""
    summary, sigma = record.summary, record.scans.triple("sigma_position")
    known = np.linalg.norm(sigma[np.isfinite(sigma).all(axis=1)], axis=1)
    rows = []
    if len(known) and summary.distance > 0.0:
        worst = float(known.max())
        rows.append((
            "relative",
            f"one sigma of the position against the start is {_metres(float(known[-1]))} at the end and "
            f"{_metres(worst)} at most, {worst / summary.distance:.2%} of {summary.distance:.0f} m"
            "; as the estimator believes it",
        ))  # fmt: skip
    graph = summary.graph
    gnss = None if graph is None else graph.gnss
    rows.append(
        (
            "absolute",
            str(gnss_facts(gnss)["sentence"])
            if gnss is not None
            else "not tied to the Earth: no satellite fix was used",
        )
    )
    rows.append(("level", summary.level.sentence() or "not known: up is the sensor's own at the start"))
    body = "".join(f"<div><dt>{name}</dt><dd>{escape(text)}</dd></div>" for name, text in rows)
    return f'<dl class="accuracy" id="accuracy">{body}</dl>'


def _metres(value: float) -> str:
    return f"{1e3 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"


def streams(recording: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row a sensor: topic, frame, messages, rate, and what was wrong with its messages, in words."""
    rows: list[tuple[str, ...]] = []
    for name, stream in recording.get("streams", {}).items():
        faults = [f"{stream[fault]} {fault}" for fault in _FAULTS if stream.get(fault)]
        rows.append((
            _STREAMS.get(name, name), str(recording.get("topics", {}).get(name, "")),
            str(recording.get("frames", {}).get(name, "")), f"{stream.get('count', 0)}",
            f"{stream.get('rate_hz', 0.0):.4g} Hz", ", ".join(faults) or "nothing",
        ))  # fmt: skip
    return rows


def files_beside(record: RunRecord) -> str:
    """Return links to the files that lie beside the report."""
    there = [name for name in _FILES if (record.folder / name).is_file()]
    links = "".join(f'<li><a href="{name}">{name}</a> {_FILES[name]}</li>' for name in there)
    return f'<ul class="files">{links}</ul>' if there else ""
