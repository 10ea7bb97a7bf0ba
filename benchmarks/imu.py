"""Preintegration: microseconds a sample, beside gtsam's loop in Python.

400 samples at 400 Hz, an interval of one second. One call of ours returns motion, both covariances (9 x 9 and with
walking biases 15 x 15) and the derivative by the biases; once for one such interval, once for a hundred.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.data import ImuBatch, ImuNoise
from heliograph.imu import preintegrate

__all__ = ["measure"]

_HERE = Path(__file__).resolve().parent
_RATE, _SAMPLES, _MANY = 400, 400, 100
_NOISE = ImuNoise(gyro=1e-3, accel=1e-2, gyro_walk=1e-4, accel_walk=1e-3)


def _samples() -> ImuBatch:
    """Return a moderate motion with noise, from the start of the interval to its end."""
    rng, t = np.random.default_rng(0), np.arange(_SAMPLES + 1) / _RATE
    gyro = np.stack([0.6 * np.sin(3 * t), 0.4 * np.cos(2 * t), 0.8 * np.sin(1.1 * t + 0.3)], axis=1)
    accel = np.stack([1.5 * np.sin(5 * t), np.cos(4 * t), 9.81 + 0.8 * np.sin(3 * t)], axis=1)
    return ImuBatch(
        stamps_ns=np.round(1e9 * t).astype(np.int64),
        gyro=gyro + rng.normal(scale=0.002, size=gyro.shape),
        accel=accel + rng.normal(scale=0.02, size=accel.shape),
        received_ns=0,
    )


def _ours(imu: ImuBatch, intervals: int, runs: int) -> float:
    """Return the median over the runs, microseconds a sample."""
    starts, ends = np.full(intervals, imu.stamps_ns[0]), np.full(intervals, imu.stamps_ns[-1])
    times = []
    for _ in range(runs + 1):  # the first warms up
        began = time.perf_counter()
        preintegrate(imu, starts, ends, noise=_NOISE)
        times.append(1e6 * (time.perf_counter() - began) / (intervals * _SAMPLES))
    return statistics.median(times[1:])


def measure(work: Path, rival: Path, *, runs: int) -> list[dict[str, Any]]:
    """Return one row a system and kind of call; runs alternate between the systems, ours and theirs five times."""
    imu, found = _samples(), []
    work.mkdir(parents=True, exist_ok=True)
    path = work / "imu_samples.npz"
    noise = {"gyro_noise": _NOISE.gyro, "accel_noise": _NOISE.accel}
    np.savez(path, gyro=imu.gyro[:-1], accel=imu.accel[:-1], dt=1.0 / _RATE, **noise)
    for _ in range(5):
        turn = {("heliograph", "one call"): _ours(imu, 1, 10 * runs)}
        turn["heliograph", f"one call for {_MANY} intervals"] = _ours(imu, _MANY, runs)
        if rival.exists():
            command = [rival, _HERE / "imu_rivals" / "gtsam_preintegrate.py", path, str(runs)]
            account = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            turn["gtsam", "Python loop"] = account["plain_us"]
            turn["gtsam", "Python loop, combined"] = account["combined_us"]
            theirs = account["version"]
        found.append(turn)
    if not rival.exists():
        print(f"{rival} is not there: gtsam is left out", file=sys.stderr)
    rows = []
    for system, call in found[0]:
        us = statistics.median(turn[system, call] for turn in found)
        number = version("heliograph") if system == "heliograph" else theirs
        rows.append({"benchmark": "imu", "system": system, "version": number, "call": call, "us_a_sample": us})
    return rows
