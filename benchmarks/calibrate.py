"""Calibration of simulated recordings: errors against the bars, and whether the sigmas are honest.

A trial draws a clock (up to 30 ms, 50 ppm) and starts from a mounting wrong by up to 5 deg and 0.3 m. Its row is
added to the results file when it is done, so several processes may work on one file, each with trials of its own.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from heliograph.calibration import Calibration, calibrate
from heliograph.calibration.observability import difference
from heliograph.config import RunConfig
from heliograph.data import Rig
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate

__all__ = ["MOTIONS", "calibration_section", "run_trials", "trial"]

MOTIONS = ("calibration", "planar")
_BAR = "0.2 deg, 1 cm, 0.5 ms of what the motion told; the mean normalised square inside its 95 % band"
_HEAD = ["motion", "trials", "error", "median", "95 %", "largest"]
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def run_trials(motion: str, seeds: range, file: Path) -> None:
    """Run the trials that the file does not hold yet and add one line each."""
    file.parent.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        done = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
        if any((row["motion"], row["seed"]) == (motion, seed) for row in done):
            continue
        line = json.dumps(trial(motion, seed))
        with file.open("a") as rows:
            rows.write(line + "\n")  # one short write at the file's end is not torn by another process's
        print(line, flush=True)


def trial(motion: str, seed: int) -> dict[str, Any]:
    """Return one calibration's errors along what the motion told, in SI units."""
    rng = np.random.default_rng([11, seed])
    clock = {"clock_offset": rng.uniform(-0.03, 0.03), "clock_drift_ppm": rng.uniform(-50.0, 50.0)}
    sensors = simulate(SCENARIOS[motion].varied(imu=clock), seed)
    turn, shift = rng.standard_normal((2, 3))
    wrong = sensors.rig.T_imu_lidar.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp(np.radians(5.0) * rng.uniform() * turn / np.linalg.norm(turn))
    wrong[:3, 3] += 0.3 * rng.uniform() * shift / np.linalg.norm(shift)
    began = time.process_time()
    found = calibrate(sensors, Rig(T_imu_lidar=wrong, source="wrong"), RunConfig())
    seconds = time.process_time() - began
    middle = np.int64(found.rig.clock.reference_ns)
    offset = float(sensors.clock.offset_at(middle)) - found.rig.clock.offset
    drift = sensors.clock.drift - found.rig.clock.drift
    error = np.concatenate([difference(found.rig.T_imu_lidar, sensors.rig.T_imu_lidar), [offset, drift]])
    nees, told = _nees(found, error)
    return {
        "motion": motion,
        "seed": seed,
        "error": found.observed.told(error).tolist(),
        "sigma": [axis.sigma for axis in found.axes],
        "verdicts": [axis.verdict for axis in found.axes],
        "nees": nees,
        "told": told,
        "passes": found.passes,
        "settled": found.converged,
        "cpu_s": round(seconds, 2),
    }


def _nees(found: Calibration, error: NDArray[np.float64]) -> tuple[float, int]:
    """Return the normalised squared error of what the motion told, and how many numbers that is."""
    observed = found.observed
    parts = (np.linalg.inv(observed.directions) @ error)[~observed.kept]
    return float(np.sum(parts**2 * (1.0 + observed.gains[~observed.kept] ** 2))), len(parts)


def calibration_section(rows: Sequence[dict[str, Any]], table: Table) -> str:
    """Return the section of BENCHMARKS.md."""
    body, lines = [], []
    for motion in MOTIONS:
        mine = [row for row in rows if row["motion"] == motion]
        if not mine:
            continue
        error = np.array([row["error"] for row in mine])
        sizes = {
            "rotation [deg]": np.degrees(np.linalg.norm(error[:, :3], axis=1)),
            "lever arm [mm]": 1e3 * np.linalg.norm(error[:, 3:6], axis=1),
            "offset [ms]": 1e3 * np.abs(error[:, 6]),
            "drift [ppm]": 1e6 * np.abs(error[:, 7]),
        }
        for name, size in sizes.items():
            numbers = [f"{np.quantile(size, q):.4f}" for q in (0.5, 0.95, 1.0)]
            body.append([motion, str(len(mine)), name, *numbers])
        lines.append(_consistency(motion, mine))
    return "\n".join(
        [
            "## LiDAR-IMU calibration",
            "",
            "Simulated recordings of 24 s; wrong at the start by up to 5 deg, 0.3 m, 30 ms and 50 ppm. "
            f"Bar: {_BAR}. `python -m benchmarks calibrate`.",
            "",
            table(_HEAD, body),
            "",
            *lines,
            "",
        ]
    )


def _consistency(motion: str, rows: Sequence[dict[str, Any]]) -> str:
    total, count = sum(row["told"] for row in rows), len(rows)
    mean = sum(row["nees"] for row in rows) / count
    low, high = chi2.ppf([0.025, 0.975], total) / count
    kept = sorted({f"{sum(v == 'not excited' for v in row['verdicts'])}" for row in rows})
    seconds = float(np.median([row["cpu_s"] for row in rows]))
    verdict = "inside" if low < mean < high else "OUTSIDE"
    return (
        f"* {motion}: mean normalised squared error {mean:.2f} of {total / count:.2f} numbers, {verdict} the band "
        f"[{low:.2f}, {high:.2f}]; axes not excited: {', '.join(kept)}; {seconds:.1f} s of processor time a trial."
    )
