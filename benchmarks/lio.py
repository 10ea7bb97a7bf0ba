"""Graphs of LiDAR-inertial mapping on a real drive, smoothed one keyframe at a time, beside gtsam on the same numbers.

KITTI sequence 00 with its real IMU. LiDAR steps and loops are drawn about the truth (2 mrad, 5 cm), fixes of an antenna
on a lever arm likewise (1, 1, 2 m). Two graphs: `lio` has LiDAR steps and loops, and a fix every fifth keyframe; `gnss`
has no steps, but a fix every keyframe, and loops. Runs of the systems alternate, each in a process of its own.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.imu_drive import FIX_SIGMA, START_SIGMA, Drive
from benchmarks.imu_gnss import readings
from heliograph.arrays import Array
from heliograph.data import ImuNoise
from heliograph.lie import se3, se23

__all__ = ["GRAPHS", "compare", "write_task"]

_HERE = Path(__file__).resolve().parent
GRAPHS = ("lio", "gnss")

# As a front end sets it: far above the sensor's own, so that steps of a LiDAR and the IMU do not contradict each other.
_NOISE = ImuNoise(gyro=1.75e-3, accel=5e-2, gyro_walk=1e-5, accel_walk=1e-3)
_LAG_S = 0.068  # of the IMU's stamps behind the truth's, as `imu_gnss` estimates it
_STRIDE, _EDGE = 10, 20  # poses of the truth from keyframe to keyframe, a second, and left out at either end
_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # takes the camera's axes to the car's
_MOUNT = np.array([-0.334, 0.025, -1.099])  # of the IMU in the camera frame
_DOWN = 9.81 * np.array([0.03, -0.036, -0.9988])  # in the frame of the truth, whose camera is not level
_ARM = np.array([0.3, 0.0, 1.2])
_STEP_SIGMA = np.array([0.002] * 3 + [0.05] * 3)
_NEAR_M, _APART = 3.0, 30  # a loop joins places this near that many keyframes apart


def _truth(folder: Path) -> tuple[NDArray[np.int64], Array]:
    """Return stamps (N,) [ns] and states (N, 5, 5) of the keyframes."""
    poses = np.loadtxt(folder / "groundtruth_kitti.txt").reshape(-1, 3, 4)
    times = np.loadtxt(folder / "groundtruth_times.txt")
    chosen = np.arange(_EDGE, len(poses) - _EDGE, _STRIDE)
    T, seconds = poses[chosen], times[chosen]
    R = _CAMERA @ T[:, :, :3] @ _CAMERA.T
    p = (T[:, :, 3] + T[:, :, :3] @ _MOUNT) @ _CAMERA.T
    v = np.gradient(p, seconds, axis=0)
    return np.round(1e9 * seconds).astype(np.int64), se23.from_rotation_position_velocity(R, p, v)


def write_task(folder: Path, name: str, target: Path, *, seed: int = 0) -> None:
    """Write a graph as arrays: states' start, readings, LiDAR steps (N - 1, or none), loops, fixes; and the truth."""
    rng, (stamps, X) = np.random.default_rng(seed), _truth(folder)
    drive = Drive.read(folder).shifted(_LAG_S)
    T = se3.from_rotation_translation(X[:, :3, :3], X[:, :3, 3])
    p = X[:, :3, 3]
    tree, pairs = cKDTree(p), []
    for k in range(len(p)):
        near = [i for i in tree.query_ball_point(p[k], _NEAR_M) if i < k - _APART]
        pairs += [(min(near), k)] if near else []
    loops = np.array(pairs)

    def measured(i: Any, j: Any) -> Array:  # noqa: ANN401 - indices
        return np.asarray(se3.retract(se3.inverse(T[i]) @ T[j], _STEP_SIGMA * rng.normal(size=(len(j), 6))))

    keys = np.arange(len(p))
    steps = measured(keys[:-1], keys[1:]) if name == "lio" else np.zeros((0, 4, 4))
    fixed = keys[::5] if name == "lio" else keys
    fixes = p + np.einsum("nij,j->ni", X[:, :3, :3], _ARM) + FIX_SIGMA * rng.normal(size=p.shape)
    imu = drive.imu
    np.savez(
        target,
        stamps=stamps,
        start=X[0],
        truth=p,
        steps=steps,
        loops=loops,
        closed=measured(loops[:, 0], loops[:, 1]),
        fixed=fixed,
        fixes=fixes[fixed],
        arm=_ARM,
        gravity=_DOWN,
        step_sigma=_STEP_SIGMA,
        fix_sigma=FIX_SIGMA,
        start_sigma=np.array([0.01] * 3 + [0.1] * 3 + [0.5] * 3) if name == "lio" else START_SIGMA,
        bias_sigma=np.array([0.01] * 3 + [0.3] * 3),
        imu_stamps=imu.stamps_ns,
        imu_gyro=imu.gyro,
        imu_accel=imu.accel,
        noise=[_NOISE.gyro, _NOISE.accel, _NOISE.gyro_walk, _NOISE.accel_walk],
        **readings(drive, stamps, _NOISE),
    )


def compare(folder: Path, work: Path, rival: Path, ours: Path, *, runs: int) -> list[dict[str, Any]]:
    """Return one row a graph and system: medians over alternated runs of what each run says of its updates."""
    work = work / "lio"
    work.mkdir(parents=True, exist_ok=True)
    systems = {"heliograph": (ours, "heliograph_lio.py")}
    if rival.exists():
        systems["gtsam"] = (rival, "gtsam_lio.py")
    # One thread; and the scripts find this package.
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(_HERE.parent)}
    rows = []
    for name in GRAPHS:
        task = work / f"{name}.npz"
        write_task(folder, name, task)
        found: dict[str, list[dict[str, Any]]] = {system: [] for system in systems}
        for _ in range(runs):
            for system, (program, script) in systems.items():
                command = [program, _HERE / "imu_rivals" / script, task]
                done = subprocess.run(command, capture_output=True, text=True, check=True, env=alone)
                found[system].append(json.loads(done.stdout.splitlines()[-1]))
        for system, accounts in found.items():
            row = {key: statistics.median(a[key] for a in accounts) for key in accounts[0] if key != "version"}
            number = version("heliograph") if system == "heliograph" else accounts[0]["version"]
            rows.append({"benchmark": "lio", "graph": name, "system": system, "version": number, "runs": runs, **row})
    return rows
