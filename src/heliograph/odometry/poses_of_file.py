"""Poses of another system as an `Odometry`: a file of them, looked up scan by scan."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Stamps
from heliograph.config import RunConfig
from heliograph.data import Event, GnssFix, ImuBatch, Scan, ScanResult, Trajectory
from heliograph.data.error_layout import POSE_DIM, POSITION, ROTATION
from heliograph.errors import DataError
from heliograph.lie import interpolate_se3, se3, so3
from heliograph.odometry.pose_result import pose_result
from heliograph.odometry.protocol import Odometry
from heliograph.snapshots import Stateful, array

__all__ = ["PoseFileOdometry"]

_NEAR_NS = 2_000_000  # a pose this close to a scan's stamp is the scan's own
_CHOSEN_NS = 200_000_000  # poses that come slower than this, as a rule, are another system's keyframes
_LONGEST_GAP_NS = 1_500_000_000  # poses farther apart are not interpolated


class PoseFileOdometry(Odometry, Stateful):
    """Gives each scan the pose that a trajectory has at its header stamp; the clouds are taken as de-skewed.

    Between two poses it interpolates; a scan outside of them, or in a gap, is left out and counted. What the poses may
    have drifted is not known: the covariance grows with the way by `SlamConfig.pose_rotation_sigma_deg` and
    `SlamConfig.pose_position_sigma`.

    Parameters
    ----------
    trajectory : Trajectory
        Poses of the IMU, or of the LiDAR where the recording has no IMU.
    config : RunConfig
    T_imu_lidar : (4, 4) float64
        Mounting.

    Raises
    ------
    DataError
        The trajectory holds no pose.
    """

    _STATE: ClassVar = {
        "events": [Event],
        "_before": (ScanResult, None),
        "_covariance": array(np.float64, 6, 6),
        "_count": int,
        "_left_out": int,
        "_first_left_ns": int,
    }

    def __init__(self, trajectory: Trajectory, config: RunConfig, T_imu_lidar: Array) -> None:
        if len(trajectory.stamps_ns) == 0:
            raise DataError("the file of poses holds none; give a trajectory in TUM or KITTI rows")
        self.events: list[Event] = []
        self._trajectory, self._T_imu_lidar = trajectory, T_imu_lidar
        self._rotation = math.radians(config.slam.pose_rotation_sigma_deg)
        self._position = config.slam.pose_position_sigma
        self._before: ScanResult | None = None
        self._covariance = np.zeros((6, 6))
        self._count = self._left_out = 0
        self._first_left_ns = 0

    @property
    def chosen_ns(self) -> Stamps:
        """Times of the poses that are a choice of keyframes, (N,) [ns]: all where they come slowly, else none."""
        stamps = self._trajectory.stamps_ns
        slow = len(stamps) > 1 and float(np.median(np.diff(stamps))) > _CHOSEN_NS
        return stamps if slow else stamps[:0]

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[ScanResult]:
        """Return the result of a scan that has a pose; other messages say nothing here."""
        if not isinstance(message, Scan):
            return []
        stamp_ns = message.header_stamp_ns
        T = self._pose_at(stamp_ns)
        if T is None or (self._before is not None and stamp_ns <= self._before.end_ns):
            self._first_left_ns = self._first_left_ns or stamp_ns
            self._left_out += 1
            return []
        # A de-skewed cloud is one of an instant, whatever its points' own times say.
        message = replace(message, stamp_ns=stamp_ns, end_ns=stamp_ns, offsets_ns=np.zeros_like(message.offsets_ns))
        self._covariance = self._grown(T)
        result = pose_result(
            message, self._count, T, before=self._before, T_imu_lidar=self._T_imu_lidar, covariance=self._covariance,
            status="tracked" if self._count else "first",
        )  # fmt: skip
        self._before, self._count = result, self._count + 1
        return [result]

    def finish(self) -> list[ScanResult]:
        """Say how many scans had no pose.

        Raises
        ------
        DataError
            None had one.
        """
        if self._left_out and self._before is None:
            raise DataError(
                f"none of the {self._left_out} scans has a pose in the file, which reaches from "
                f"{1e-9 * self._trajectory.stamps_ns[0]:.3f} to {1e-9 * self._trajectory.stamps_ns[-1]:.3f} s; the "
                f"first scan is of {1e-9 * self._first_left_ns:.3f} s: give the poses of this recording, in its time"
            )
        if self._left_out:
            message = (
                f"{self._left_out} scans have no pose in the file and are left out: it reaches from "
                f"{1e-9 * self._trajectory.stamps_ns[0]:.3f} to {1e-9 * self._trajectory.stamps_ns[-1]:.3f} s"
            )
            event = Event(code="no-pose", message=message, stamp_ns=self._first_left_ns, count=self._left_out)
            self.events.append(event)
            self._left_out = 0
        return []

    def _pose_at(self, stamp_ns: int) -> Array | None:
        stamps = self._trajectory.stamps_ns
        after = int(np.searchsorted(stamps, stamp_ns))
        for near in (after - 1, after):
            if 0 <= near < len(stamps) and abs(int(stamps[near]) - stamp_ns) <= _NEAR_NS:
                return np.array(self._trajectory.T_frame_body[near])
        if not 0 < after < len(stamps) or stamps[after] - stamps[after - 1] > _LONGEST_GAP_NS:
            return None
        T = interpolate_se3(stamps, self._trajectory.T_frame_body, np.array([stamp_ns]))
        return np.array(T[0])

    def _grown(self, T: Array) -> NDArray[np.float64]:
        """Return the covariance of rotation (body) and position (odom) at the next pose, (6, 6)."""
        if self._before is None:
            return np.zeros((6, 6))
        T_odom_before = self._before.T_odom_imu
        R, moved = se3.inverse(T_odom_before)[:3, :3] @ T[:3, :3], T[:3, 3] - T_odom_before[:3, 3]
        way = float(np.linalg.norm(moved)) + float(np.linalg.norm(so3.log(R)))
        carry = np.eye(POSE_DIM)  # an error of the earlier rotation moves the later position
        carry[ROTATION, ROTATION] = R.T
        carry[POSITION, ROTATION] = -so3.hat(moved) @ T_odom_before[:3, :3]
        noise = np.repeat([self._rotation**2 * way, self._position**2 * way], 3)
        return np.asarray(carry @ self._covariance @ carry.T + np.diag(noise))
