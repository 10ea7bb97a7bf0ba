"""The LiDAR alone, thinned, to poses: what calibration and examination compare an IMU with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from heliograph.config import RunConfig
from heliograph.data import Rig, Scan, ScanResult
from heliograph.odometry.filter.odometry import FilterOdometry

__all__ = ["follow_lidar", "thrifty"]


def thrifty(config: RunConfig, matches: int) -> RunConfig:
    """Return the configuration with about ``matches`` points to match a scan with: motion shows in few of them."""
    return replace(config, cloud=replace(config.cloud, target_points=max(1, matches)))


def follow_lidar(
    scans: Iterable[Scan], config: RunConfig, *, matches: int | None = None, threads: int = 1
) -> Iterator[ScanResult]:
    """Yield what an odometry without an IMU makes of scans, one result a scan, in order.

    Parameters
    ----------
    scans : iterable of Scan
        In time order, thinned as the caller sees fit; taken one by one as results are asked for.
    config : RunConfig
        What the odometry is to be like.
    matches : int, optional
        Points to match a scan with; half of ``config.cloud.target_points`` if not given.
    threads : int
        Threads of the native loops; the results do not depend on them.

    Yields
    ------
    ScanResult
        Its imu frame is the lidar frame itself: ``T_odom_imu`` is T_odom_lidar. The first come when the first second is
        there, or all of it.
    """
    matches = matches if matches is not None else config.cloud.target_points // 2
    sensor = Rig(T_imu_lidar=np.eye(4), source="the lidar frame itself")
    odometry = FilterOdometry(thrifty(config, matches), sensor, sensors=frozenset({"lidar"}), threads=threads)
    for scan in scans:
        yield from odometry.add(scan)
    yield from odometry.finish()
