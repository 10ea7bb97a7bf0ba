"""What an odometry says about one scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.data.event import Event
from heliograph.data.online_calibration import OnlineCalibration
from heliograph.data.trajectory import Trajectory

__all__ = ["ScanResult", "ScanStatus"]

ScanStatus: TypeAlias = Literal["first", "tracked", "degenerate", "predicted", "lost", "empty"]
"""How a scan fared; see `ScanResult`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanResult:
    """The state at a scan's end, its uncertainty, the de-skewed cloud, and how the update went.

    Parameters
    ----------
    index : int
        Number of the LiDAR message in the run, from 0.
    stamp_ns, header_stamp_ns, end_ns : int
        Start of the sweep, the message's own stamp, end of the sweep [ns].
    T_odom_imu : (4, 4) float64
        Pose at ``end_ns``.
    v_odom : (3,) float64
        Velocity [m/s].
    gyro_bias : (3,) float64
        [rad/s].
    accel_bias : (3,) float64
        [m/s^2].
    g_odom : (3,) float64
        Gravity [m/s^2].
    T_imu_lidar : (4, 4) float64
        Mounting as used for this scan.
    covariance : (K, K) float64
        Covariance of the filter's error state, in the order of `heliograph.data.error_layout`.
    pose_covariance : (6, 6) float64
        Covariance of rotation (body) and position (odom) against the odom frame's origin: the filter's own, which takes
        the map as it is, plus what the map itself has drifted.
    path : Trajectory
        odom frame, imu body: the poses from the previous scan's end to this one's, at the IMU samples in between and at
        both ends, and at ``header_stamp_ns`` where that lies inside.
    T_odom_imu_header : (4, 4) float64
        Pose at ``header_stamp_ns``.
    points_imu : (N, 3) float32
        The de-skewed points in the imu frame at ``end_ns`` [m]. One a valid point of the message inside the range gate.
    intensity : (N,) float32 or None
        Intensity of those points.
    status : ScanStatus
        ``"first"``, ``"tracked"``, ``"degenerate"``, ``"predicted"`` (nothing matched; the motion model carried on),
        ``"lost"``, ``"empty"``.
    matches : int
        Points with a plane.
    fallback_matches : int
        Those among them that the nearest-neighbour fallback found.
    queries : int
        Points that looked for one.
    iterations : int
        Iterations of the update.
    rms : float
        Robust RMS of the point-to-plane residuals after the update [m].
    nis : float
        Squared correction of the pose in units of its predicted uncertainty; about 6 on average when that is honest.
    eigenvalues_rotation, eigenvalues_translation : (3,) float64
        Eigenvalues of the per-measurement information matrix, ascending [1/rad^2 m^2 scaled to 1 m lever; 1].
        In [0, 1] for translation.
    weak_share : float
        Share of what the scan says about the least seen direction of its pose that is more than noise of the normals
        can feign, in [0, 1], with the scans before where it alone is not sure; 0 where it does not see it, which makes
        the scan ``"degenerate"``.
    weak_direction : (3,) float64
        Unit vector along the least observed translation, odom frame.
    lidar_information : (6, 6) float64
        What the scan alone told of rotation (body) and position (odom) against the map, without the prediction; zero
        where nothing matched.
    timings : mapping
        Stage name -> milliseconds.
    events : tuple of Event
        What went wrong in this scan.
    calibration : OnlineCalibration or None
        Where mounting or clock are estimated along.
    """

    index: int
    stamp_ns: int
    header_stamp_ns: int
    end_ns: int
    T_odom_imu: NDArray[np.float64]
    v_odom: NDArray[np.float64]
    gyro_bias: NDArray[np.float64]
    accel_bias: NDArray[np.float64]
    g_odom: NDArray[np.float64]
    T_imu_lidar: NDArray[np.float64]
    covariance: NDArray[np.float64]
    pose_covariance: NDArray[np.float64]
    path: Trajectory
    T_odom_imu_header: NDArray[np.float64]
    points_imu: NDArray[np.float32]
    intensity: NDArray[np.float32] | None
    status: ScanStatus
    matches: int = 0
    fallback_matches: int = 0
    queries: int = 0
    iterations: int = 0
    rms: float = float("nan")
    nis: float = float("nan")
    eigenvalues_rotation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    eigenvalues_translation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    weak_share: float = float("nan")
    weak_direction: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    lidar_information: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 6)))
    timings: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    calibration: OnlineCalibration | None = None

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def weak_sigma(self) -> float:
        """One-sigma of the position along `weak_direction` against the odom frame's origin [m]."""
        return float(np.sqrt(max(float(self.weak_direction @ self.pose_covariance[3:, 3:] @ self.weak_direction), 0.0)))

    @property
    def matched(self) -> bool:
        """Whether the pose rests on the scan's points: it began the map, or was matched to it."""
        return self.status in ("first", "tracked", "degenerate")
