"""Which scans become keyframes, and what is kept of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Stamps
from heliograph.cloud import voxel_downsample
from heliograph.config import SlamConfig
from heliograph.data import ImuBatch, Keyframe, ScanResult
from heliograph.lie import se3
from heliograph.maps import transformed
from heliograph.odometry.sequencer import ImuBuffer
from heliograph.slam.covariances import graph_covariance, graph_information, step_covariance
from heliograph.snapshots import PART, Stateful, array

__all__ = ["KeyframeSelector"]

_NEAR_M, _CUBE_M = 15.0, 1.0  # points are compared up to this distance, in cubes of this edge
_COMPARED, _FEWEST = 2000, 100  # of them at most, and at least
_SAME_NS = 2_000_000  # a cloud this close to a chosen time is the one that was chosen
_OTHERS_NS = 200_000_000  # clouds that come slower than this are another system's keyframes


class KeyframeSelector(Stateful):
    """Watches a run and makes a keyframe of a scan when the body has moved on, turned, stood for a while, or sees new.

    A scan that was not matched makes none: where the LiDAR saw nothing, there is nothing to come back to.

    Parameters
    ----------
    config : SlamConfig
    poses_given : bool
        Whether the poses are another system's: clouds that come slower than five times a second are its keyframes.
    chosen_ns : (N,) int64, optional
        Times, sorted, of clouds that another system chose as keyframes, however close together [ns].
    """

    _STATE: ClassVar = {
        "_imu": PART,
        "_last": (ScanResult, None),
        "_seen": array(np.int64, None),
        "_count": int,
    }

    def __init__(self, config: SlamConfig, *, poses_given: bool = False, chosen_ns: Stamps | None = None) -> None:
        self._config, self._poses_given = config, poses_given
        self._chosen_ns = np.zeros(0, dtype=np.int64) if chosen_ns is None else chosen_ns
        self._imu = ImuBuffer()
        self._last: ScanResult | None = None
        self._seen = np.zeros(0, dtype=np.int64)  # cubes that the last keyframe's scan saw, sorted
        self._count = 0

    def observe(self, samples: ImuBatch) -> None:
        """Take inertial samples, in the order in which the odometry gets them."""
        newest = self._imu.last_ns
        late = 0 if newest is None else int(np.searchsorted(samples.stamps_ns, newest, side="right"))
        self._imu.append(samples[late:] if late else samples)

    def add(self, result: ScanResult) -> Keyframe | None:
        """Take the next scan's result; return a keyframe if it is to be one."""
        if not result.matched or len(result.points_imu) == 0 or not self._due(result):
            return None
        picked = voxel_downsample(result.points_imu, self._config.cloud_voxel)
        keyframe = Keyframe(
            index=self._count,
            stamp_ns=result.end_ns,
            T_odom_imu=result.T_odom_imu,
            v_odom=result.v_odom,
            gyro_bias=result.gyro_bias,
            accel_bias=result.accel_bias,
            g_odom=np.zeros(3) if self._poses_given else result.g_odom,  # nobody says which way is up in their frame
            step_covariance=self._step_covariance(result),
            lidar_information=graph_information(result.lidar_information, result.T_odom_imu),
            points_imu=result.points_imu[picked],
            intensity=None if result.intensity is None else result.intensity[picked],
            imu=self._samples(result),
        )
        self._imu.forget_before(result.end_ns)
        self._seen = np.unique(_cubes(result, result.T_odom_imu))
        self._last, self._count = result, self._count + 1
        return keyframe

    def _due(self, result: ScanResult) -> bool:
        last, config = self._last, self._config
        if last is None:
            return True
        if self._poses_given and result.end_ns - last.end_ns > _OTHERS_NS:
            return True
        if self._is_chosen(result.end_ns):
            return True
        step = se3.local(last.T_odom_imu, result.T_odom_imu)
        return bool(
            np.linalg.norm(result.T_odom_imu[:3, 3] - last.T_odom_imu[:3, 3]) >= config.keyframe_distance
            or np.linalg.norm(step[:3]) >= math.radians(config.keyframe_angle_deg)
            or result.end_ns - last.end_ns >= 1e9 * config.keyframe_interval
            or self._overlap(result, last.T_odom_imu) < config.keyframe_overlap
        )

    def _is_chosen(self, stamp_ns: int) -> bool:
        at = int(np.searchsorted(self._chosen_ns, stamp_ns - _SAME_NS))
        return at < len(self._chosen_ns) and bool(self._chosen_ns[at] <= stamp_ns + _SAME_NS)

    def _overlap(self, result: ScanResult, T_odom_last: Array) -> float:
        """Return the share of what a scan sees near by that the last keyframe's saw; 1 where either saw too little."""
        if self._config.keyframe_overlap == 0.0 or len(self._seen) == 0:
            return 1.0
        cubes = _cubes(result, T_odom_last)
        if len(cubes) < _FEWEST:
            return 1.0
        at = np.minimum(np.searchsorted(self._seen, cubes), len(self._seen) - 1)
        return float(np.mean(self._seen[at] == cubes))

    def _step_covariance(self, result: ScanResult) -> Array:
        if self._last is None:
            return np.zeros((6, 6))
        least = np.concatenate(
            [
                np.full(3, math.radians(self._config.step_rotation_sigma_deg)),
                np.full(3, self._config.step_position_sigma),
            ]
        )
        before, after = self._last, result
        return step_covariance(
            before.T_odom_imu,
            after.T_odom_imu,
            graph_covariance(before.pose_covariance, before.T_odom_imu),
            graph_covariance(after.pose_covariance, after.T_odom_imu),
            least,
        )

    def _samples(self, result: ScanResult) -> ImuBatch:
        """Return the samples since the last keyframe, stamped by the LiDAR's clock where the filter tells the two."""
        start_ns = result.end_ns if self._last is None else self._last.end_ns
        account = result.calibration
        if account is None or account.imu_offset == 0.0:
            return self._imu.between(start_ns, result.end_ns)
        late_ns = round(1e9 * account.imu_offset)
        samples = self._imu.between(start_ns + late_ns, result.end_ns + late_ns)
        return replace(samples, stamps_ns=samples.stamps_ns - late_ns)


def _cubes(result: ScanResult, T_odom_frame: Array) -> NDArray[np.int64]:
    """Return the cubes of some pose's frame in which a scan has points near by, one entry a point."""
    points = result.points_imu[:: 1 + len(result.points_imu) // _COMPARED]
    near = points[np.einsum("ni,ni->n", points, points) < _NEAR_M**2]
    T = se3.inverse(T_odom_frame) @ result.T_odom_imu
    cells = np.floor(transformed(np.ascontiguousarray(near), T) / np.float32(_CUBE_M)).astype(np.int64) + (1 << 20)
    return np.asarray((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])
