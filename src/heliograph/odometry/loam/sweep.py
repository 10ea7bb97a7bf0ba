"""The features of one sweep, moved by its motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.cloud import ScanFeatures, deskew
from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.imu import ImuPath
from heliograph.maps import FeaturePoints

__all__ = ["FeatureSweep"]


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
        self.count = len(features)
        self._scan, self._features, self._T_imu_lidar, self._threads = scan, features, T_imu_lidar, threads
        self._deskews = config.cloud.deskew != "off"

    @property
    def before_end(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """How long before the sweep's end edges (E,) and planar points (P,) were seen [s]; zeros if none are moved."""
        edges, planes = (self._before_end(k) for k in (self._features.edges, self._features.planes))
        return edges, planes

    def _before_end(self, indices: NDArray[np.int32]) -> NDArray[np.float32]:
        if not self._deskews:
            return np.zeros(len(indices), np.float32)
        span_ns = self._scan.end_ns - self._scan.stamp_ns
        return np.asarray((span_ns - self._scan.offsets_ns[indices]) * np.float64(1e-9), dtype=np.float32)

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
