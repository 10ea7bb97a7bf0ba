"""A simulated shift of many hours: memory and time of the back-end, keyframe by keyframe, without clouds and loops.

Run it with ``python -m benchmarks.long_shift --hours 4``; one line every thousand keyframes.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import ImuBatch, Keyframe
from heliograph.lie import se3
from heliograph.slam.back_end import BackEnd
from heliograph.slam.store import KeyframeStore

_SECOND, _RATE = 10**9, 200
_REPORTED = 1000  # keyframes


def keyframes(count: int) -> Iterator[Keyframe]:
    """Yield a keyframe a second on a circle of 20 m at 1 m/s, with the samples of a usual IMU between them."""
    rng = np.random.default_rng(15)
    turn, step = 0.05, np.diag(np.repeat([1e-4, 2e-3], 3) ** 2)
    stamps = np.arange(-_SECOND - _SECOND // _RATE, _SECOND // _RATE + 1, _SECOND // _RATE)
    for k in range(count):
        noise = rng.standard_normal((2, len(stamps), 3))
        T = se3.exp((k % 100_000) * np.array([0.0, 0.0, turn, 1.0, 0.0, 0.0]))
        imu = ImuBatch(
            stamps_ns=stamps + k * _SECOND, gyro=np.array([0.0, 0.0, turn]) + 1e-3 * noise[0],
            accel=np.array([0.0, turn, 9.80665]) + 1e-2 * noise[1], received_ns=k * _SECOND,
        )  # fmt: skip
        yield Keyframe(
            index=k, stamp_ns=k * _SECOND, T_odom_imu=T @ se3.exp(1e-3 * rng.standard_normal(6)),
            v_odom=T[:3, 0].copy(), gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
            g_odom=np.array([0.0, 0.0, -9.80665]), step_covariance=step if k else np.zeros((6, 6)),
            lidar_information=np.diag(np.repeat([1e8, 1e6], 3)), points_imu=np.zeros((1, 3), np.float32),
            intensity=None, imu=imu,
        )  # fmt: skip


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def measure(hours: float, window: int, folder: Path) -> None:
    """Print memory and CPU time of a shift."""
    config = RunConfig()
    config = replace(config, slam=replace(config.slam, loops=False, window=window))
    back_end, spent = BackEnd(config, KeyframeStore.create(folder)), []
    last = _resident()
    for keyframe in keyframes(round(3600 * hours)):
        began = time.process_time()
        back_end.add(keyframe)
        spent.append(1e3 * (time.process_time() - began))
        if len(spent) == _REPORTED:
            gc.collect()
            now, tree = _resident(), back_end._smoother.bytes
            p50, p99 = np.percentile(spent, [50, 99])
            print(
                f"{keyframe.index + 1}: {now / 1e6:.0f} MB, {(now - last) / _REPORTED / 1e3:.1f} kB a keyframe, "
                f"tree {tree / 1e6:.0f} MB; {p50:.1f} ms, p99 {p99:.1f}, max {max(spent):.1f}",
                flush=True,
            )
            last, spent = now, []
    back_end.store.close()
    back_end.release()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=4.0)
    parser.add_argument("--window", type=int, default=RunConfig().slam.window)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as path:
        measure(arguments.hours, arguments.window, Path(path))
