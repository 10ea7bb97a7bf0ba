"""The result of an odometry that knows poses and no more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.config import ImuConfig
from heliograph.data import Scan, ScanResult, ScanStatus, Trajectory
from heliograph.data.error_layout import NAV_DIM, POSE
from heliograph.lie import interpolate_se3

__all__ = ["pose_result"]


def pose_result(
    scan: Scan,
    index: int,
    T_odom_imu: NDArray[np.float64],
    *,
    before: ScanResult | None = None,
    T_imu_lidar: NDArray[np.float64] | None = None,
    covariance: NDArray[np.float64] | None = None,
    status: ScanStatus = "tracked",
) -> ScanResult:
    """Return a result with a scan's pose; what else a result tells is left at zero.

    Parameters
    ----------
    scan : Scan
        Its points are taken as they are: where the sensor moves, de-skew them first (`heliograph.cloud.deskew`).
    index : int
        Number of the scan in the run, from 0.
    T_odom_imu : (4, 4) float64
        Pose at the scan's end [m].
    before : ScanResult, optional
        Result of the scan before: the path begins at its end, the velocity is the mean one since then.
    T_imu_lidar : (4, 4) float64, optional
        Mounting; by default the frames are one.
    covariance : (6, 6) float64, optional
        Covariance of rotation (body) and position (odom); zero by default.
    status : ScanStatus
        As in `ScanResult`.
    """
    T_imu_lidar = np.eye(4) if T_imu_lidar is None else T_imu_lidar
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    stamps, poses, velocity = [scan.end_ns], [T_odom_imu], np.zeros(3)
    if before is not None and before.end_ns < scan.end_ns:
        stamps, poses = [before.end_ns, scan.end_ns], [before.T_odom_imu, T_odom_imu]
        velocity = (T_odom_imu[:3, 3] - before.T_odom_imu[:3, 3]) / (1e-9 * (scan.end_ns - before.end_ns))
    path = Trajectory(stamps_ns=np.array(stamps, dtype=np.int64), T_frame_body=np.stack(poses))
    header_ns = np.clip(np.int64(scan.header_stamp_ns), path.stamps_ns[0], path.stamps_ns[-1])
    whole = np.zeros((NAV_DIM, NAV_DIM))
    whole[POSE, POSE] = covariance
    valid = np.isfinite(scan.points).all(axis=1)
    points = scan.points[valid] @ T_imu_lidar[:3, :3].T.astype(np.float32) + T_imu_lidar[:3, 3].astype(np.float32)
    return ScanResult(
        index=index,
        stamp_ns=scan.stamp_ns,
        header_stamp_ns=scan.header_stamp_ns,
        end_ns=scan.end_ns,
        T_odom_imu=T_odom_imu,
        v_odom=velocity,
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        g_odom=np.array([0.0, 0.0, -ImuConfig().gravity]),
        T_imu_lidar=T_imu_lidar,
        covariance=whole,
        pose_covariance=covariance,
        path=path,
        T_odom_imu_header=interpolate_se3(path.stamps_ns, path.T_frame_body, header_ns),
        points_imu=np.ascontiguousarray(points, dtype=np.float32),
        intensity=None if scan.intensity is None else scan.intensity[valid],
        status=status,
    )
