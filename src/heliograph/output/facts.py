"""What ``run.json`` says."""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.checks import VERDICT_WORDS, Finding
from heliograph.data import GraphAccount, Rig, SensorRepair, StartAccount
from heliograph.output.blind_spans import BlindSpan
from heliograph.output.georeference import gnss_facts
from heliograph.output.level import Level
from heliograph.output.manifest import hashed_files
from heliograph.output.reasons import Reason, next_action, reason_facts
from heliograph.output.record import RunRecord
from heliograph.output.summary import RunSummary

__all__ = ["RUN_SCHEMA", "final_facts", "graph_facts", "peak_memory_mb", "versions"]


RUN_SCHEMA = "heliograph run 1"
"""Schema of ``run.json``, see run.schema.json beside this file: names may be added, none changes or goes."""


def versions() -> dict[str, str]:
    """Return the versions that the result depends on."""
    from importlib.metadata import PackageNotFoundError, version

    def installed(package: str) -> str:
        try:
            return version(package)
        except PackageNotFoundError:
            return "not installed"

    return {
        "heliograph": installed("heliograph"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "rosbags": installed("rosbags"),
        "platform": platform.platform(),
    }


def peak_memory_mb() -> float | None:
    """Return this process's peak resident memory [MB], or None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)


def final_facts(
    facts: Mapping[str, Any],
    record: RunRecord,
    files: Sequence[Path],
    writer_seconds: Mapping[str, float],
    closing_seconds: float,
    failures: Sequence[Exception],
) -> dict[str, Any]:
    """Return the account of a finished run, of JSON's own types only (NaN becomes null).

    Parameters
    ----------
    facts : mapping
        What was known before the run.
    record : RunRecord
        The run.
    files : sequence of Path
        Files written.
    writer_seconds : mapping
        Writer -> seconds.
    closing_seconds : float
        Since the last scan.
    failures : sequence of Exception
        Writers' failures.
    """
    summary = record.summary
    failure = summary.failure or "; ".join(str(failure) for failure in failures)
    # A run of which something is not there is none that is well, however well its scans went.
    status = "incomplete" if failure and summary.status == "ok" else summary.status
    ended = [Reason("failure", f"it did not end, or not all could be written: {failure}")] if failure else []
    reasons = [*summary.reasons, *ended]
    account = {
        "schema": RUN_SCHEMA,
        "status": status,
        "reasons": reasons,
        "verdict": {
            "code": status,
            "reasons": reason_facts(reasons),
            "action": next_action(status, reasons, failure),
        },
        "interrupted": summary.interrupted,
        "failure": failure,
        "sensors": list(summary.sensors),
        "scans": summary.scans,
        "scan_verdicts": dict(summary.statuses),
        "distance_m": summary.distance,
        "duration_s": summary.duration,
        "start_end_gap_m": summary.start_end_gap,
        "weakest": {
            "scan": summary.weakest_index,
            "eigenvalue": summary.weakest_eigenvalue,
            "direction_map": summary.weakest_direction.tolist(),
        },
        **({"graph": graph_facts(summary.graph)} if summary.graph is not None else {}),
        "checks": [finding_facts(finding) for finding in summary.findings],
        **({"repairs": [_repair(repair) for repair in summary.repairs]} if summary.repairs else {}),
        **({"resumed": [{"at_scan": scans} for scans in summary.resumed]} if summary.resumed else {}),
        "blind_spans": [_blind(span) for span in summary.blind_spans],
        "level": _level(summary.level),
        **({"start": _start(summary.start)} if summary.start is not None else {}),
        "warnings": [asdict(event) for event in summary.events],
        "timings": _timings(summary, writer_seconds, closing_seconds),
        "peak_memory_mb": peak_memory_mb(),
        **({"mounting": _mounting(summary.rig)} if summary.rig is not None else {}),
        "map_points": record.map_points,
        "map_points_moving": record.moving_points,
        "T_map_odom": summary.T_map_odom.tolist(),
        **facts,
        "folder": str(record.folder),
        "files": [path.name for path in files],
        "outputs": hashed_files(path for path in files if path.name != "run.json"),
    }
    return {key: plain(value) for key, value in account.items()}


def graph_facts(graph: GraphAccount) -> dict[str, Any]:
    """Return what the back-end made of the run, as ``run.json`` has it."""
    loops = {name: getattr(graph, name) for name in ("candidates", "accepted", "held", "rejected", "revoked")}
    gnss = {} if graph.gnss is None else {"gnss": gnss_facts(graph.gnss)}
    wheels = {} if graph.wheels is None else {"wheels": asdict(graph.wheels)}
    return {"keyframes": graph.keyframes, "moved_m": graph.moved, "loops": loops, **gnss, **wheels}


def finding_facts(finding: Finding) -> dict[str, Any]:
    """Return one verdict of the checks as ``run.json`` has it."""
    return {
        "code": finding.code,
        "title": finding.title,
        "verdict": VERDICT_WORDS[finding.verdict],
        "evidence": finding.evidence,
        "remedy": finding.remedy,
        "numbers": [asdict(number) for number in finding.numbers],
        "picture": finding.picture,
    }


def _repair(repair: SensorRepair) -> dict[str, Any]:
    """Return what was mended, with the numbers that were put in place."""
    clock, rig = repair.clock, repair.rig
    account: dict[str, Any] = {"code": repair.code, "sentence": repair.sentence}
    for name in ("gyro", "accel"):
        if not np.array_equal(getattr(repair, name), np.eye(3)):
            account[f"{name}_factor"] = getattr(repair, name).tolist()
    if not clock.exact:
        account["imu_clock"] = {
            "offset_s": clock.offset, "drift_ppm": 1e6 * clock.drift, "reference_ns": clock.reference_ns,
        }  # fmt: skip
    if rig is not None:
        account["T_imu_lidar"] = rig.T_imu_lidar.tolist()
    return account


def _mounting(rig: Rig) -> dict[str, Any]:
    """Return the mounting that a run used, as `--extrinsic` takes it from there."""
    return {
        "T_imu_lidar": rig.T_imu_lidar.tolist(),
        "source": rig.source,
        "known": rig.known,
        "sigma_rotation_deg": float(np.degrees(rig.sigma_rotation)),
        "sigma_lever_m": rig.sigma_translation,
    }


def _blind(span: BlindSpan) -> dict[str, Any]:
    """Return a stretch along which one direction was not seen, with its cost in metres."""
    return {
        "scans": [span.first, span.last],
        "stamps_ns": [span.begin_ns, span.end_ns],
        "direction_map": span.direction.tolist(),
        "distance_m": span.distance,
        "sigma_before_m": span.sigma_before,
        "sigma_after_m": span.sigma_after,
        "growth_m": span.growth,
    }


def _level(level: Level) -> dict[str, Any]:
    """Return how well it is known which way is up, in degrees, and in metres of height at the farthest place."""
    known = level.known
    return {
        "sigma_deg": math.degrees(level.sigma) if known else None,
        "sigma_height_m": level.sigma_position if known else None,
        "reach_m": level.reach,
        "sentence": level.sentence(),
    }


def _start(start: StartAccount) -> dict[str, Any]:
    """Return how the odometry began, in the units that people read."""
    account = {
        "kind": start.kind,
        "verdict": start.verdict,
        "reason": start.reason,
        "data_s": start.duration,
        "gravity_sigma_deg": math.degrees(start.gravity_sigma),
        "velocity_sigma": start.velocity_sigma,
        "gyro_bias_sigma": start.gyro_bias_sigma,
        "accel_bias_sigma": start.accel_bias_sigma,
    }
    if start.kind == "static":
        account["stillness"] = start.stillness
    if start.kind == "moving":
        account["excitation"] = {
            "turned_deg": math.degrees(start.turned),
            "rate_rms": start.rate_rms,
            "force_rms": start.force_rms,
        }
        account["misfit"] = start.misfit
        account["accel_scale"] = start.accel_scale
        account["accel_scale_sigma"] = start.accel_scale_sigma
        account["unobservable"] = list(start.unobservable)
    return account


def _timings(summary: RunSummary, writer_seconds: Mapping[str, float], closing_seconds: float) -> dict[str, Any]:
    """Return where the time went: stages of the run, stages of the odometry, writers apart."""
    wall = summary.wall_seconds + closing_seconds
    return {
        **{f"{name}_s": value for name, value in summary.seconds.items()},
        "writing_s": sum(writer_seconds.values()),
        "wall_s": wall,
        "closing_s": closing_seconds,
        "wall_ms_per_scan": summary.ms_per_scan,
        "odometry_ms_per_scan": dict(summary.stage_ms),
        "writers_ms_per_scan": {name: 1e3 * value / summary.scans for name, value in writer_seconds.items()},
    }


def plain(value: Any) -> Any:  # noqa: ANN401 - any value in, JSON's types out
    """Return ``value`` in JSON's own types: arrays as lists, paths as text, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (str, int, bool)) else str(value)
