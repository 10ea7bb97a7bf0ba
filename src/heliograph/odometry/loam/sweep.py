"""The features of one sweep, moved by its motion; and that motion from the scan before, where no IMU tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.cloud import ScanFeatures, deskew
from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.imu import ImuPath
from heliograph.lie import se3
from heliograph.maps import FeatureMap, FeaturePoints
from heliograph.registration import FeatureNoise, register_features

__all__ = ["FeatureSweep", "ScanToScan", "ended"]

_ROUNDS = 6  # of de-skewing and registering
_SETTLED_ROTATION, _SETTLED_POSITION = 2e-4, 2e-3  # a round that changes the motion by less is the last [rad], [m]


class FeatureSweep:
    """The features of a sweep, each with its own time.

    Parameters
    ----------
    scan : Scan
    features : ScanFeatures
        Those of the scan.
    T_imu_lidar : (4, 4) float64
    config : RunConfig
    threads : int
    """

    def __init__(self, scan: Scan, features: ScanFeatures, T_imu_lidar: Array, config: RunConfig, threads: int) -> None:
        self.seconds = float(scan.end_ns - scan.stamp_ns) * 1e-9
        self.count = len(features)
        self._scan, self._features, self._T_imu_lidar, self._threads = scan, features, T_imu_lidar, threads
        self._deskews = config.cloud.deskew != "off"

    def points(self, path: ImuPath) -> FeaturePoints:
        """Return the features to match, de-skewed along a path, imu frame at its end."""
        return FeaturePoints(
            edges=self._moved(self._features.edges, path), planes=self._moved(self._features.planes, path)
        )

    def map_points(self, path: ImuPath) -> FeaturePoints:
        """Return the features for the map, de-skewed along a path, imu frame at its end."""
        return FeaturePoints(
            edges=self._moved(self._features.map_edges, path), planes=self._moved(self._features.map_planes, path)
        )

    def share(self, path: ImuPath) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the part of the motion along a path that each feature to match has behind it when it is measured."""
        span = max(float(path.stamps_ns[-1] - path.stamps_ns[0]), 1.0)
        return self._part(self._features.edges, span), self._part(self._features.planes, span)

    def _part(self, indices: NDArray[np.int32], span: float) -> NDArray[np.float32]:
        if not self._deskews:
            return np.ones(len(indices), np.float32)
        sweep_ns = self._scan.end_ns - self._scan.stamp_ns
        before_end = (sweep_ns - self._scan.offsets_ns[indices]).astype(np.float64)
        return np.asarray(np.clip(1.0 - before_end / span, 0.0, 1.0), dtype=np.float32)

    def _moved(self, indices: NDArray[np.int32], path: ImuPath) -> NDArray[np.float32]:
        first = 0 if self._deskews else len(path.stamps_ns) - 1
        return deskew(
            self._scan.points[indices],
            self._scan.offsets_ns[indices],
            stamp_ns=self._scan.stamp_ns,
            path_stamps_ns=path.stamps_ns[first:],
            R_odom_body=path.R_odom_imu[first:],
            p_odom=path.p_odom[first:],
            T_body_lidar=self._T_imu_lidar,
            threads=self._threads,
        )


class ScanToScan:
    """The motion of a sweep from the features of the scan before: LOAM's odometry at the rate of the scans.

    Parameters
    ----------
    config : RunConfig
    threads : int
    """

    def __init__(self, config: RunConfig, *, threads: int) -> None:
        # Of one scan there is one point where the map has many: thin and far apart lines and planes must do.
        loam = replace(config.loam, max_points=1)
        self._config, self._filter, self._threads = loam, config.filter, threads
        self._noise = FeatureNoise(edge=config.loam.edge_sigma, plane=config.loam.plane_sigma)
        self._last = FeatureMap(loam, radius=config.map.radius)

    def led(self, path: ImuPath, sweep: FeatureSweep) -> ImuPath:
        """Return the path with the motion at which the sweep fits the scan before; ``path`` where it does not.

        The motion is taken for constant since the scan before. A feature measured when the share s of the way was
        behind the sensor moves by that share of a correction, eq. (5) of docs/theory/loam.md, and is de-skewed anew
        after each. Were it moved by all of it, an error of one scan would come back in the next with the opposite
        sign, undamped.
        """
        if len(self._last) == 0 or sweep.count == 0:
            return path
        begun, T_odom_first = path, se3.from_rotation_translation(path.R_odom_imu[0], path.p_odom[0])
        for _ in range(_ROUNDS):
            T = se3.inverse(T_odom_first) @ se3.from_rotation_translation(path.R_odom_imu[-1], path.p_odom[-1])
            found = register_features(
                self._last,
                sweep.points(path),
                T,
                noise=self._noise,
                config=self._config,
                settings=self._filter,
                share=sweep.share(path),
                max_iterations=1,
                threads=self._threads,
            )
            if found.sums.matches < self._filter.min_matches:
                return begun
            step = se3.log(se3.inverse(T) @ found.T_odom_body)
            path = _straight(path, T_odom_first @ found.T_odom_body)
            if np.linalg.norm(step[:3]) < _SETTLED_ROTATION and np.linalg.norm(step[3:]) < _SETTLED_POSITION:
                break
        return path

    def remember(self, points: FeaturePoints) -> None:
        """Take the features of a scan, in the body frame at its end, for the next one."""
        self._last.clear()
        self._last.insert(points, np.eye(4))


def _straight(path: ImuPath, T_odom_end: Array) -> ImuPath:
    """Return the straight way from a path's begin to another end."""
    return replace(
        path,
        stamps_ns=path.stamps_ns[[0, -1]],
        R_odom_imu=np.stack([path.R_odom_imu[0], T_odom_end[:3, :3]]),
        p_odom=np.stack([path.p_odom[0], T_odom_end[:3, 3]]),
        v_odom=path.v_odom[[0, -1]],
    )


def ended(path: ImuPath, T_odom_end: Array) -> ImuPath:
    """Return the same motion, moved as a whole so that it ends elsewhere."""
    T = se3.from_rotation_translation(path.R_odom_imu, path.p_odom)
    T = T_odom_end @ se3.inverse(T[-1]) @ T
    return replace(path, R_odom_imu=T[:, :3, :3], p_odom=T[:, :3, 3])
