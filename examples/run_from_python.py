"""Run a recording from Python: poses as they come, then the path's length and whether any scan was doubtful.

python examples/run_from_python.py RECORDING [TRAJECTORY.tum]
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import ScanResult, Trajectory
from heliograph.io import open_recording, write_tum
from heliograph.metrics import path_length
from heliograph.odometry import make_odometry


def track(recording_path: Path) -> list[ScanResult]:
    with open_recording(recording_path) as recording:
        for inference in recording.inferences:
            print(f"{inference.name}: {inference.value} ({inference.evidence})")
        odometry = make_odometry(RunConfig(), recording.rig, recording.sensors, threads=2)
        results = []
        for message in recording.stream():  # in the order in which the recorder got them
            results += odometry.add(message)  # a scan's result comes once the IMU has passed its end
        return results + odometry.finish()


def main() -> None:
    results = track(Path(sys.argv[1]))
    trajectory = Trajectory(
        stamps_ns=np.array([r.header_stamp_ns for r in results]),
        T_frame_body=np.stack([r.T_odom_imu_header for r in results]),
        frame="odom",
        body="imu",
    )
    print(f"{len(results)} scans, {path_length(trajectory):.2f} m, verdicts {dict(Counter(r.status for r in results))}")
    sigma = np.sqrt(np.diag(results[-1].pose_covariance))
    print(f"1-sigma at the end: {np.rad2deg(sigma[:3].max()):.3f} deg, {1e3 * sigma[3:].max():.1f} mm")
    if len(sys.argv) > 2:
        write_tum(Path(sys.argv[2]), trajectory, "T_odom_imu, stamp = header stamp of a scan [s]")


if __name__ == "__main__":
    main()
