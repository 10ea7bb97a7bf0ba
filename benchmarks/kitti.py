"""Accuracy on KITTI raw 2011_09_26_0005: a car, an HDL-64E that is not de-skewed, an IMU at 10 Hz, a loose truth."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.accuracy import accuracy, evo_ate, in_imu_frame
from benchmarks.process import measure, version_of
from benchmarks.rivals import Adapter, Job
from heliograph.io import open_recording, read_cloud, read_tum
from heliograph.metrics import map_sharpness

__all__ = ["compare", "sharpness"]

_OTHER = {"imu": "lidar", "lidar": "imu"}
_SHARPNESS_RADII = (0.3, 0.5)


def compare(data: Path, adapters: Iterable[Adapter], work: Path, bins: dict[str, Path]) -> list[dict[str, Any]]:
    """Run every system on the recording and return one row each."""
    recording = data / "recording"
    truth = read_tum(data / "groundtruth_imu.tum")
    T_imu_lidar = open_recording(recording).rig.T_imu_lidar  # /tf_static, which is KITTI's calibration
    rows = []
    for adapter in adapters:
        out = work / adapter.name
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        job = Job(recording=recording, lidar_topic="/velodyne_points", out=out, bin=bins[adapter.name], cores=2)
        cost = measure(
            adapter.command(job), log=work / f"{adapter.name}.log", environment=adapter.environment(job), cores=2
        )
        reported = adapter.trajectory(job)
        path = in_imu_frame(reported, T_imu_lidar)
        errors = accuracy(path, truth)
        # The frame that an adapter claims is checked: read as the other sensor's, the poses must fit the truth worse.
        mistaken = dataclasses.replace(reported, body=_OTHER[reported.body])
        if mistaken.body == "imu":
            other = accuracy(mistaken, truth)
        else:
            other = accuracy(in_imu_frame(mistaken, T_imu_lidar), truth)
        rows.append(
            {
                "benchmark": "kitti_0005",
                "system": adapter.name,
                "version": version_of(adapter.package, bins[adapter.name]),
                "sensors": adapter.sensors,
                "body": adapter.body,
                **dataclasses.asdict(errors),
                "ate_evo_m": evo_ate(path, truth, errors.shift_ms * 1e-3),
                "ate_as_other_body_m": other.ate_m,
                "rpe_translation_as_other_body_m": other.rpe_translation_m,
                **dataclasses.asdict(cost),
            }
        )
    return rows


def sharpness(data: Path, ours: Adapter, work: Path, bins: dict[str, Path]) -> list[dict[str, Any]]:
    """Return how crisp our map is with de-skewing and without."""
    rows = []
    for deskew in ("imu", "off"):
        out = work / f"sharpness_{deskew}"
        job = Job(recording=data / "recording", lidar_topic="", out=out, bin=bins[ours.name], cores=2)
        settings = ["--set", f"cloud.deskew={deskew}", "--set", "output.map_voxel=0.05"]
        measure([*ours.command(job), *settings], log=work / f"sharpness_{deskew}.log", environment={}, cores=2)
        cloud = read_cloud(out / "run" / "map.ply").points
        for radius in _SHARPNESS_RADII:
            result = map_sharpness(cloud, radius)
            rows.append({"benchmark": "kitti_0005_sharpness", "deskew": deskew, **dataclasses.asdict(result)})
    return rows
