"""How likely noisy fixes are under a noise of the IMU: by the innovations of a filter, without any truth.

What `imu_drive` takes for the noise is checked by it: `python -m benchmarks.imu_likelihood FOLDER` prints the table.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.imu_drive import BIAS_SIGMA, CONFIG, FIX_SIGMA, GRAVITY, NOISE, START_SIGMA, Drive, Task
from heliograph.arrays import Array
from heliograph.config import ImuConfig
from heliograph.data import ImuNoise
from heliograph.imu import preintegrate
from heliograph.lie import ExtendedPose, se23

__all__ = ["log_likelihood"]

_WARM = 30  # fixes before any counts


def log_likelihood(drive: Drive, fixes: Array, noise: ImuNoise, config: ImuConfig) -> float:
    """Return the logarithm of the density of the fixes after the first ones, up to a constant."""
    motion = preintegrate(drive.imu, drive.stamps_ns[:-1], drive.stamps_ns[1:], noise=noise, config=config)
    X, bias, R = Task.of(drive, fixes).start[0], np.zeros(6), np.diag(FIX_SIGMA**2)
    P, total = np.diag(np.concatenate([START_SIGMA, BIAS_SIGMA]) ** 2), 0.0
    for k in range(len(motion)):
        one = motion[k : k + 1]
        delta = one.corrected(bias[:3], bias[3:]).delta.matrix[0]
        X = one.predict(X, bias[:3], bias[3:], GRAVITY)[0]
        F, shift = np.eye(15), np.eye(9)
        shift[3:6, 6:] = one.duration_s[0] * np.eye(3)
        F[:9, :9] = se23.adjoint(se23.inverse(delta)) @ shift
        F[:9, 9:] = one.bias_jacobian[0]
        P = F @ P @ F.T + one.combined[0]
        if not drive.measured[k + 1]:
            continue
        H = np.zeros((3, 15))
        H[:, 3:6] = X.rotation
        innovation, S = fixes[k + 1] - X.position, H @ P @ H.T + R
        gain = np.linalg.solve(S, H @ P).T
        step, keep = gain @ innovation, np.eye(15) - gain @ H
        X, bias = ExtendedPose(X.matrix).retract(step[:9]), bias + step[9:]
        P = keep @ P @ keep.T + gain @ R @ gain.T
        if k >= _WARM:
            total -= 0.5 * float(innovation @ np.linalg.solve(S, innovation) + np.linalg.slogdet(S)[1])
    return total


def _print_table(folder: Path) -> None:
    drive = Drive.read(folder)
    fixes = drive.noisy(0)
    for name in ("gyro", "accel", "gyro_walk", "accel_walk"):
        shown = getattr(NOISE, name)
        for factor in (0.3, 0.5, 1.0, 2.0, 3.0):
            found = log_likelihood(drive, fixes, replace(NOISE, **{name: factor * shown}), CONFIG)
            print(f"{name} {factor * shown:.3g}: {found:.1f}")
    for gyro in (0.03, 0.05, 0.07, 0.1, 0.15):
        for accel in (0.2, 0.35, 0.5, 1.0):
            config = replace(CONFIG, held_gyro_noise=gyro, held_accel_noise=accel)
            print(f"held {gyro:g} {accel:g}: {log_likelihood(drive, fixes, NOISE, config):.1f}")


if __name__ == "__main__":
    _print_table(Path(sys.argv[1]))
