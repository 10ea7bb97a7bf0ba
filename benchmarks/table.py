"""benchmarks/BENCHMARKS.md from benchmarks/results/*.jsonl."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import blind_section
from benchmarks.calibrate import calibration_section
from benchmarks.global_alignment import global_section
from benchmarks.gnss import georeference_section
from benchmarks.graph_sigmas import graph_sigmas_section
from benchmarks.graph_table import graph_section, graph_summary, scale_section
from benchmarks.healthy import healthy_section
from benchmarks.imu_table import gnss_section, lio_section, preintegration_section
from benchmarks.incremental_table import incremental_scale_section, incremental_section
from benchmarks.kd_tree import kd_tree_section
from benchmarks.lab import lab_section
from benchmarks.live import live_section
from benchmarks.loam import loam_section
from benchmarks.localization_table import localization_section
from benchmarks.loop_misled import misled_section
from benchmarks.loop_runs import loop_runs_section
from benchmarks.loops import loops_section
from benchmarks.match_scores import scores_section
from benchmarks.outages import outages_section
from benchmarks.outliers import outliers_section
from benchmarks.registration import registration_section
from benchmarks.report_page import report_page_section
from benchmarks.side_by_side import side_by_side_section
from benchmarks.sigmas import sigmas_section
from benchmarks.speed import busy_section
from benchmarks.start import start_section
from benchmarks.wheels import wheels_section

__all__ = ["write_readme", "write_table"]

_Rows = list[dict[str, Any]]
_OTHER_SECTIONS = {
    "speed_busy": busy_section,
    "start": start_section,
    "graph": graph_section,
    "graph_scale": scale_section,
    "graph_incremental": incremental_section,
    "graph_incremental_scale": incremental_scale_section,
    "graph_outliers": outliers_section,
    "imu": preintegration_section,
    "imu_gnss": gnss_section,
    "lio": lio_section,
    "loam": loam_section,
    "live": live_section,
    "lab": lab_section,
    "report_page": report_page_section,
    "calibrate": calibration_section,
    "registration": registration_section,
    "global_alignment": global_section,
    "blind": blind_section,
    "kd_tree": kd_tree_section,
    "loops": loops_section,
    "loop_misled": misled_section,
    "loop_runs": loop_runs_section,
    "side_by_side": side_by_side_section,
    "localization": localization_section,
    "match_scores": scores_section,
    "sigmas": sigmas_section,
    "graph_sigmas": graph_sigmas_section,
    "georeference": georeference_section,
    "wheels": wheels_section,
    "healthy": healthy_section,
    "outages": outages_section,
}


def _load(results: Path) -> dict[str, _Rows]:
    files = results.glob("*.jsonl")
    return {file.stem: [json.loads(line) for line in file.read_text().splitlines()] for file in files}


def write_table(results: Path, target: Path) -> None:
    """Write every result that is there, each section with the bar it is held against."""
    found = _load(results)
    sections = [_INTRO]
    for name, section in (("kitti", _kitti), ("sharpness", _sharpness), ("speed", _speed)):
        if name in found:
            sections.append(section(found[name]))
    for name, section_of in _OTHER_SECTIONS.items():
        if name in found:
            sections.append(section_of(found[name], _table))
    target.write_text("\n".join(sections))


def write_readme(results: Path, target: Path) -> None:
    """Replace what stands between the marks in the README by the short table."""
    found = _load(results)
    timed = {r["system"]: r for r in found.get("speed", [])}
    body = []
    for r in found.get("kitti", []):
        t = timed.get(r["system"])
        simulated = ["-"] * 4
        if t is not None:
            milliseconds = [f"{t[key]:.0f}" for key in ("wall_ms_per_scan", "cpu_ms_per_scan")]
            simulated = [f"{1e3 * t['ate_m']:.1f}", *milliseconds, f"{t['peak_mb']:.0f}"]
        kitti = [f"{r['ate_m']:.2f}", f"{r['rpe_rotation_deg']:.3f}"]
        body.append([r["system"], r["sensors"], *kitti, *simulated])
    head = ["", "sensors", "KITTI ATE m", "RPE deg / 10 m", "warehouse ATE mm", "wall ms a scan", "cpu ms", "peak MB"]
    _put(target, _MARKS, _table(head, body))
    if "graph" in found:
        _put(target, _GRAPH_MARKS, graph_summary(found["graph"], _table))


def _put(target: Path, marks: tuple[str, str], text: str) -> None:
    """Replace what stands between two marks."""
    before, start, rest = target.read_text().partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if end:
        target.write_text(f"{before}{start}\n{text}{end}{after}")


_MARKS = ("<!-- benchmarks: written by `python -m benchmarks table` -->", "<!-- /benchmarks -->")
_GRAPH_MARKS = ("<!-- graphs: written by `python -m benchmarks table` -->", "<!-- /graphs -->")

_INTRO = """# Benchmarks

Written by `make bench` (`python -m benchmarks table`); do not edit. Each system runs with its own defaults, on the
same recording, on the same machine. All poses are brought to the IMU frame with the calibration, shifted by the one
constant time within 60 ms that suits their own relative rotation best (shown), interpolated at the truth's stamps.
ATE: RMSE of position after SE(3) alignment without scale. RPE: RMSE over 10 m of path, every pose with the first later
one at least 10 m further along.
"""


def _kitti(rows: _Rows) -> str:
    ours = next((r for r in rows if r["system"] == "heliograph"), None)
    rivals = [r for r in rows if r["system"] != "heliograph"]
    body = [
        [
            f"{r['system']} {r['version']}",
            r["sensors"],
            r["poses"],
            f"{r['ate_m']:.3f}",
            f"{r['rpe_translation_m']:.3f}",
            f"{r['rpe_rotation_deg']:.3f}",
            f"{r['rpe_rotation_unshifted_deg']:.3f}",
            f"{r['shift_ms']:+.1f}",
        ]
        for r in rows
    ]
    head = ["system", "sensors", "poses", "ATE m", "RPE m", "RPE deg", "unshifted deg", "shift ms"]
    text = "## Accuracy on a real drive: KITTI raw 2011_09_26_0005\n\n" + _table(head, body)
    text += (
        "\nAn HDL-64E at 9.65 Hz, not de-skewed, and an IMU at 10 Hz only; 39 m in 10 s, starting at 3.2 m/s. The "
        "truth's position is loose (INS without RTK, 0.3-0.5 m), its rotation good.\n"
    )
    if ours and rivals:
        best = min(rivals, key=lambda r: r["rpe_rotation_deg"])
        median = statistics.median(r["ate_m"] for r in rivals)
        rotation = ours["rpe_rotation_deg"] / best["rpe_rotation_deg"]
        gap = max(abs(r["ate_evo_m"] - r["ate_m"]) for r in rows)
        text += (
            f"Relative rotation: {rotation:.2f} times that of {best['system']}, the best rival (bar: 1.1). "
            f"ATE: {ours['ate_m'] / median:.2f} times the rivals' median (bar: 1.1). "
            f"evo gives the same ATE from the same poses to {gap:.0e} m.\n"
        )
    return text


def _sharpness(rows: _Rows) -> str:
    body = [
        [
            f"{r['radius']:g}",
            r["deskew"],
            f"{1e3 * r['thickness']:.0f}",
            f"{r['entropy']:.2f}",
            f"{100 * r['coverage']:.1f}",
        ]
        for r in sorted(rows, key=lambda r: (r["radius"], r["deskew"]))
    ]
    head = ["radius m", "de-skewing", "thickness mm", "entropy nat", "coverage %"]
    text = "## What de-skewing does to that drive's map\n\n" + _table(head, body)
    return text + "\nSurface thickness and mean map entropy of `map.ply` (5 cm); lower is crisper.\n"


def _speed(rows: _Rows) -> str:
    body = [
        [
            f"{r['system']} {r['version']}",
            f"{r['wall_ms_per_scan']:.1f}",
            f"{r['cpu_ms_per_scan']:.1f}",
            "-" if r["writers_ms_per_scan"] is None else f"{r['writers_ms_per_scan']:.1f}",
            f"{r['peak_mb']:.0f}",
            f"{1e3 * r['ate_m']:.1f}",
            f"{r['rotation_deg']:.3f}",
            f"{r['rpe_rotation_deg']:.3f}",
            f"{r['shift_ms']:+.1f}",
        ]
        for r in rows
    ]
    head = ["system", "wall ms", "cpu ms", "of it writers ms", "peak MB", "ATE mm", "rot. deg", "RPE deg", "shift ms"]
    first = rows[0]
    text = f"## Time a scan of the whole command: simulated warehouse, {first['scans']} scans of 64 x 1024\n\n"
    text += _table(head, body)
    return text + (
        f"\nTwo threads allowed, median of {first['runs']} runs taken in turn, from the command's start to its end, "
        "reading and all outputs included. Heliograph writes trajectories, map, log and report, rko-lio a trajectory.\n"
        "A simulated scene is static, its planes clean, its clocks perfect: expect less of every system in the field.\n"
    )


def _table(head: Sequence[str], body: Sequence[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *body)]
    return "\n".join(lines) + "\n"
