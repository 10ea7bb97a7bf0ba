"""Starts in motion beside the same course begun at rest, through the command line alone.

Each case is simulated twice, with the rest before it and without; both are run and scored by the truth that the
simulator wrote. The static run is scored over the same stretch of the way, and as a whole.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from heliograph.data import Trajectory
from heliograph.io import read_tum
from heliograph.metrics import align, associate, evaluate
from heliograph.sim import SCENARIOS, Scenario
from heliograph.sim.scenario import to_toml

__all__ = ["START_CASES", "compare_starts", "start_section"]

_Rows = list[dict[str, Any]]
_BAR = 2.0  # times the static start's error
_SECOND_NS = 1_000_000_000
_WHIRL = {"frequency": 2.0, "yaw_deg": 73.0, "roll_deg": 10.0, "pitch_deg": 8.0}
_JUMP = {"frequency": 1.05, "bounce": 0.27}
_POOR_IMU = {"gyro_bias": 0.05, "accel_bias": 0.3}

START_CASES: MappingProxyType[str, tuple[Scenario, str]] = MappingProxyType(
    {
        "constant speed": (SCENARIOS["start-constant"], "1.5 m/s along an aisle, on wheels"),
        "turning": (SCENARIOS["start-turning"], "in the middle of a bend of 1.6 m, at 1.5 m/s"),
        "shaking": (SCENARIOS["start-shaking"], "hand-held in a room, 3 Hz, up to 3 rad/s"),
        "vehicle": (SCENARIOS["start-vehicle"], "15 m/s on a street, straight at first"),
        "whirl": (
            SCENARIOS["start-shaking"].varied(gait=_WHIRL, walk={"duration": 8.0}),
            "hand-held, turning at more than 4 rad/s",
        ),
        "jump": (
            SCENARIOS["start-constant"].varied(gait=_JUMP, walk={"duration": 8.0}),
            "up and down by 0.27 m at 1.05 Hz: in free fall for a part of each second",
        ),
        "biased constant": (
            SCENARIOS["start-constant"].varied(imu=_POOR_IMU),
            "constant speed, biases of 0.3 m/s² and 0.05 rad/s (one sigma)",
        ),
        "biased shaking": (
            SCENARIOS["start-shaking"].varied(imu=_POOR_IMU),
            "shaking, the same biases",
        ),
    }
)


def compare_starts(work: Path, program: Path, *, names: Sequence[str], runs: int) -> _Rows:
    """Return one row a case and seed; ``runs`` seeds from 1."""
    return [_row(name, seed, work / "start", program) for name in names for seed in range(1, runs + 1)]


def _row(name: str, seed: int, work: Path, program: Path) -> dict[str, Any]:
    scenario, _ = START_CASES[name]
    rested = scenario.varied(walk={"begin": 0.0, "duration": scenario.walk.begin + scenario.walk.duration})
    moving, facts = _tracked(scenario, f"{name}_{seed}_moving".replace(" ", "_"), seed, work, program)
    static, _ = _tracked(rested, f"{name}_{seed}_static".replace(" ", "_"), seed, work, program)
    way_ns = int(static[1].stamps_ns[0]) + int(1e9 * scenario.walk.begin)
    ate, first = _errors(*moving)
    ate_static, first_static = _errors(_from(static[0], way_ns), static[1])
    return {
        "benchmark": "start",
        "case": name,
        "seed": seed,
        "scans": facts["scans"],
        "untracked": facts["scans"] - 1 - facts["scan_verdicts"].get("tracked", 0),
        "ate_m": ate,
        "ate_static_m": ate_static,
        "ate_static_whole_m": evaluate(*static).absolute.rmse,
        "first_second_m": first,
        "first_second_static_m": first_static,
        **{key: facts["start"][key] for key in ("kind", "verdict", "gravity_sigma_deg", "velocity_sigma")},
    }


def _tracked(
    scenario: Scenario, name: str, seed: int, work: Path, program: Path
) -> tuple[tuple[Trajectory, Trajectory], dict[str, Any]]:
    """Simulate and run; return estimate and truth, and what ``run.json`` says."""
    work.mkdir(parents=True, exist_ok=True)
    told, recording, out = work / f"{name}.toml", work / name, work / f"{name}_run"
    told.write_text(to_toml(replace(scenario, name=name)))
    subprocess.run(
        [program, "simulate", told, "-o", recording, "--seed", str(seed), "--overwrite", "--quiet"], check=True
    )
    subprocess.run([program, "run", recording, "-o", out, "--overwrite", "--quiet", "--threads", "1"], check=True)
    facts = json.loads((out / "run.json").read_text())
    return (read_tum(out / "trajectory.tum"), read_tum(recording / "groundtruth_imu.tum")), facts


def _from(trajectory: Trajectory, stamp_ns: int) -> Trajectory:
    kept = trajectory.stamps_ns >= stamp_ns
    return replace(trajectory, stamps_ns=trajectory.stamps_ns[kept], T_frame_body=trajectory.T_frame_body[kept])


def _errors(estimate: Trajectory, truth: Trajectory) -> tuple[float, float]:
    """Return the ATE, and the largest error within the first second of it [m]."""
    pair = associate(estimate, truth)
    moved = align(pair.T_estimate, pair.T_reference) @ pair.T_estimate
    error = np.linalg.norm(moved[:, :3, 3] - pair.T_reference[:, :3, 3], axis=1)
    first = pair.stamps_ns < pair.stamps_ns[0] + _SECOND_NS
    return float(np.sqrt(np.mean(error**2))), float(error[first].max())


def _ratios(part: _Rows) -> list[float]:
    return [row["ate_m"] / row["ate_static_m"] for row in part]


def _case_line(name: str, part: _Rows) -> list[Any]:
    """Return a case's line of the table."""
    return [
        name,
        START_CASES[name][1],
        len(part),
        f"{1e3 * float(np.median([row['ate_m'] for row in part])):.2f}",
        f"{1e3 * float(np.median([row['ate_static_m'] for row in part])):.2f}",
        f"{float(np.median(_ratios(part))):.2f}",
        f"{max(_ratios(part)):.2f}",
        f"{1e3 * max(row['first_second_m'] for row in part):.1f}",
        f"{1e3 * max(row['first_second_static_m'] for row in part):.1f}",
        sum(row["untracked"] for row in part),
        ", ".join(sorted({row["verdict"] for row in part})),
    ]


def start_section(rows: _Rows, table: Any) -> str:  # noqa: ANN401
    """Return the section of BENCHMARKS.md: one line a case, the worst seed's ratio beside the medians."""
    parts = {name: [row for row in rows if row["case"] == name] for name in dict.fromkeys(r["case"] for r in rows)}
    worst = {name: max(_ratios(part)) for name, part in parts.items()}
    body = [_case_line(name, part) for name, part in parts.items()]
    missed = [f"{name} ({ratio:.2f})" for name, ratio in worst.items() if ratio > _BAR]
    head = ["start", "", "seeds", "ATE mm", "from rest mm", "ratio", "worst", "first second mm", "from rest mm"]
    text = "## Starts in motion\n\n" + table([*head, "untracked", "verdict"], body)
    return text + (
        "\nSimulated: 64 x 512 rays (32 x 512 hand-held) at 10 Hz, IMU at 200 Hz; medians over the seeds. The same "
        "course with the same sensors begun at rest is scored over the same stretch. First second: largest error of "
        "any of its poses, over all seeds. Untracked: scans without a match. "
        f"Bar: {_BAR:g} times the error from rest on every seed. "
        + (f"Missed by {', '.join(missed)}.\n" if missed else "Kept.\n")
    )
