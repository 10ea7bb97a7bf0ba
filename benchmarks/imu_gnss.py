"""IMU and 1 Hz fixes on a real drive, smoothed in one batch and one fix at a time, beside gtsam on the same numbers.

Fixes get white noise of 1 m along each horizontal axis and 2 m vertically. The start comes from the first seconds of
the data; the constant lag of the IMU's stamps behind the fixes' by the likelihood of the noisy fixes. No truth is used
but for the scores. Then the fixes are cut for 30 s at twenty places, and the prediction at the end of each cut is held
against the truth by its own covariance.
"""

from __future__ import annotations

import json
import subprocess
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.imu_drive import (
    BIAS_SIGMA,
    CONFIG,
    FIX_SIGMA,
    GRAVITY,
    NOISE,
    START_SIGMA,
    Drive,
    Task,
    rmse,
    smooth,
    smooth_online,
)
from heliograph.arrays import Array
from heliograph.data import ImuNoise
from heliograph.graph import Marginals

__all__ = ["compare", "cut_rows", "cut_summary", "lag_of", "readings", "write_task"]

_HERE = Path(__file__).resolve().parent
_LAGS = np.arange(-0.06, 0.19, 0.04)  # seconds
_PLACES, _CUT, _FIRST = 20, 30, 40  # cuts, their length and the earliest, in fixes a second apart


def lag_of(drive: Drive, fixes: Array) -> tuple[float, float]:
    """Return how far the IMU's stamps lag behind the fixes' and its standard deviation [s]: a parabola of chi2."""
    costs = [smooth(Task.of(drive.shifted(lag), fixes))[1].chi2 for lag in _LAGS.tolist()]
    curve = np.polynomial.Polynomial.fit(_LAGS, costs, 2).convert().coef
    return float(-0.5 * curve[1] / curve[2]), float(1.0 / np.sqrt(curve[2]))


def cut_rows(drive: Drive, fixes: Array, truth: Array) -> list[dict[str, Any]]:
    """Return for each cut the predicted position's error at its end against its own covariance."""
    rows = []
    for place in np.linspace(_FIRST, len(fixes) - _CUT - 3, _PLACES).astype(int).tolist():
        begin = place
        while not drive.measured[begin + _CUT] or not np.isfinite(truth[begin + _CUT, 0]):
            begin += 1  # no truth there
        end = begin + _CUT
        kept = np.arange(len(fixes)) <= begin
        graph, solution = smooth(Task.of(drive, fixes, last=end + 1, used=kept))
        state = solution.values.at(end)
        covariance = Marginals(graph, solution.values).covariance(end)[3:6, 3:6]
        error = truth[end] - state.position
        across = state.rotation.T @ error
        rows.append(
            {
                "begin_s": 1e-9 * float(drive.stamps_ns[begin]),
                "path_m": float(np.linalg.norm(np.diff(drive.fixes[begin : end + 1], axis=0), axis=1).sum()),
                "horizontal_m": float(np.linalg.norm(error[:2])),
                "vertical_m": float(abs(error[2])),
                "nees": float(across @ np.linalg.solve(covariance, across)),
                "imu_gap": bool((~drive.measured[begin : end + 1]).any()),
            }
        )
    return rows


def cut_summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean normalised squared error with its band, and the drift, cuts with a gap of the IMU apart."""
    low, high = chi2.ppf([0.025, 0.975], 3 * len(rows)) / len(rows)
    whole = [row for row in rows if not row["imu_gap"]]
    torn = [row for row in rows if row["imu_gap"]]
    return {
        "cuts": len(rows),
        "mean_nees": float(np.mean([row["nees"] for row in rows])),
        "band": [float(low), float(high)],
        "median_path_m": float(np.median([row["path_m"] for row in rows])),
        "median_drift_m": float(np.median([row["horizontal_m"] for row in whole])),
        "median_vertical_m": float(np.median([row["vertical_m"] for row in whole])),
        "cuts_with_imu_gap": len(torn),
        "median_drift_gap_m": float(np.median([row["horizontal_m"] for row in torn])) if torn else None,
    }


def readings(drive: Drive, stamps: NDArray[np.int64], noise: ImuNoise = NOISE) -> dict[str, Any]:
    """Return the readings in the middle of every step, the noise of each, and the first step from each stamp on."""
    imu = drive.imu
    knots = np.unique(np.concatenate([imu.stamps_ns, stamps]))
    knots = knots[(knots >= stamps[0]) & (knots <= stamps[-1])]
    parts = np.maximum(np.round(np.diff(knots) / 1e7).astype(int), 1)  # gaps in steps of 10 ms
    ends = np.concatenate([np.linspace(a, b, n + 1)[1:] for a, b, n in zip(knots, knots[1:], parts, strict=False)])
    t = np.concatenate([knots[:1], ends]) - stamps[0]
    middle = 0.5 * (t[1:] + t[:-1])
    gap = np.repeat(np.diff(knots) > 1e9 * CONFIG.max_gap, parts)
    at = (imu.stamps_ns - stamps[0]).astype(np.float64)
    return {
        "dt": 1e-9 * np.diff(t),
        "gyro": np.stack([np.interp(middle, at, column) for column in imu.gyro.T], axis=1),
        "accel": np.stack([np.interp(middle, at, column) for column in imu.accel.T], axis=1),
        "gyro_var": noise.gyro**2 + CONFIG.held_gyro_noise**2 * gap,
        "accel_var": noise.accel**2 + CONFIG.held_accel_noise**2 * gap,
        "first": np.searchsorted(t, stamps - stamps[0] - 1.0),
    }


def write_task(drive: Drive, task: Task, target: Path) -> None:
    """Write the task for a rival: readings in the middle of every step, and the noise of each."""
    np.savez(
        target,
        **readings(drive, drive.stamps_ns),
        walks=[NOISE.gyro_walk, NOISE.accel_walk],
        gravity=GRAVITY,
        start=task.start.matrix,
        fixes=task.fixes,
        used=task.used,
        fix_sigma=FIX_SIGMA,
        start_sigma=START_SIGMA,
        bias_sigma=BIAS_SIGMA,
    )


def compare(folder: Path, work: Path, rival: Path, *, seed: int = 0) -> list[dict[str, Any]]:
    """Return one row a system and method, and one of the cuts."""
    drive, work = Drive.read(folder), work / "imu_gnss"
    work.mkdir(parents=True, exist_ok=True)
    fixes = drive.noisy(seed)
    lag, lag_sigma = lag_of(drive, fixes)
    drive = drive.shifted(lag)
    task, keys = Task.of(drive, fixes), np.arange(len(fixes))
    began = time.perf_counter()
    _, solution = smooth(task)
    batch_s = time.perf_counter() - began
    began = time.perf_counter()
    smoother = smooth_online(task)
    online_s = time.perf_counter() - began
    noisy = rmse(drive, fixes)
    common = {
        "benchmark": "imu_gnss",
        "seed": seed,
        "noisy_rmse_m": noisy,
        "lag_ms": 1e3 * lag,
        "lag_sigma_ms": 1e3 * lag_sigma,
    }
    ours = {**common, "system": "heliograph", "version": version("heliograph")}
    rows = [
        {**ours, "method": "batch", "rmse_m": rmse(drive, solution.values.at(keys).position), "seconds": batch_s},
        {**ours, "method": "incremental", "rmse_m": rmse(drive, smoother.estimate(keys).position), "seconds": online_s},
    ]
    if rival.exists():
        write_task(drive, task, work / "task.npz")
        command = [rival, _HERE / "imu_rivals" / "gtsam_smooth.py", work / "task.npz", work / "out.npz"]
        account = json.loads(
            subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1]
        )
        found = np.load(work / "out.npz")
        for method in ("batch", "incremental"):
            theirs = {"system": "gtsam", "version": account["version"], "method": method}
            rows.append({**common, **theirs, "rmse_m": rmse(drive, found[method]), "seconds": account[f"{method}_s"]})
    truth, _ = drive.aligned(drive.fixes)
    cuts = cut_rows(drive, fixes, truth)
    return [*rows, {**ours, "method": "cuts", **cut_summary(cuts), "rows": cuts}]
