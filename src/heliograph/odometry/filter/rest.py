"""Whether a body at rest explains what a LiDAR saw as well as the motion that its own odometry made of it.

Where a LiDAR sees nothing that faces a direction, its own odometry slides along it, and one estimate of a velocity
says nothing of what else would fit as well. So the motion is not asked how fast it is, but what it is better for: both
it and rest are held against the same points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.chi_square import chi_square_quantile
from heliograph.cloud import range_gate, voxel_downsample
from heliograph.config import RunConfig
from heliograph.data import Scan, ScanResult
from heliograph.maps import PlaneMatches, VoxelMap

__all__ = ["motion_advantage", "rest_explains"]


_SURE = 0.999
_FREEDOM = 6  # numbers that a motion has to spend on a scan
# Matches of a plane share its error. Scans of a body at rest show it as often as the map has seen it, or less: at most
# it is as large as that of the mean of a scan's own points, which doubles the variance of what they say together.
_SHARED_PLANES = 2.0
_MAX_LEVELS = 8
_LEAF = 0.3  # cube edge that scans are compared with [m]
_ANY_DISTANCE = 100.0  # a gate that shuts out nothing: a plane far off where there should be one is what tells [m]


def rest_explains(scans: Sequence[Scan], results: Sequence[ScanResult], config: RunConfig) -> bool:
    """Tell whether rest explains the scans as well as a motion of six free numbers a scan does.

    Parameters
    ----------
    scans : sequence of Scan
        In time order.
    results : sequence of ScanResult
        What an odometry without an IMU made of each.
    config : RunConfig

    Notes
    -----
    The test of the likelihood ratio: if the body rests, twice its logarithm is chi-square distributed with as many
    degrees of freedom as the motion has numbers (S. S. Wilks, "The large-sample distribution of the likelihood ratio
    for testing composite hypotheses", Annals of Mathematical Statistics 9, 1938). A slide along a blind direction wins
    nothing, a motion along one that is seen wins by orders of magnitude.
    """
    freedom = _FREEDOM * (len(results) - 1)
    return freedom < 1 or motion_advantage(scans, results, config) <= _SHARED_PLANES * chi_square_quantile(
        _SURE, freedom
    )


def motion_advantage(scans: Sequence[Scan], results: Sequence[ScanResult], config: RunConfig) -> float:
    """Return twice the logarithm of the likelihood ratio of the motion over rest.

    Each scan is compared with the planes that the scans before it make, once put together by the motion and once as if
    nothing moved. Points count for which both have a plane: how densely points lie, and so where there are planes at
    all, is no evidence of rest or motion.
    """
    # What does not fit together makes thick planes: they must stay, as it is they that tell; and wider cubes catch what
    # has gone far.
    thick = replace(config.map, max_thickness=_ANY_DISTANCE, levels=min(config.map.levels + 1, _MAX_LEVELS))
    moving, resting = VoxelMap(thick), VoxelMap(thick)
    total = 0.0
    for scan, result in zip(scans, results, strict=True):
        points = scan.points[range_gate(scan.points, config.cloud.min_range, config.cloud.max_range)]
        if len(moving) > 0 and len(points) > 0:
            sigma = result.rms if math.isfinite(result.rms) else config.filter.sigma
            sigma = float(np.clip(sigma, config.filter.min_sigma, config.filter.max_sigma))
            picked = voxel_downsample(points, _LEAF)
            moved, seen_moving = _misfit(moving, result.points_imu[picked], result.T_odom_imu, sigma, config)
            still, seen_still = _misfit(resting, points[picked], result.T_imu_lidar, sigma, config)
            total += 2.0 * float((still - moved)[seen_moving & seen_still].sum())
        moving.insert(result.points_imu, result.T_odom_imu)
        resting.insert(points, result.T_imu_lidar)
    return total


def _misfit(
    planes: VoxelMap, points: NDArray[np.float32], T: Array, sigma: float, config: RunConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Return minus the logarithm of each point's likelihood under the filter's kernel, and whether it has a plane."""
    q = points @ T[:3, :3].T + T[:3, 3]
    found: PlaneMatches = planes.planes_at(q, gate=_ANY_DISTANCE, neighbours=False)
    r = np.einsum("ij,ij->i", found.normal.astype(np.float64), q - found.point)
    c2 = (config.filter.kernel * sigma) ** 2
    variance = sigma**2 + found.variance
    # A plane that is known badly forgives more and promises less: without the logarithm thick planes would win.
    return 0.5 * (r * r * c2 / (c2 + r * r) / variance + np.log(variance)), found.source > 0
