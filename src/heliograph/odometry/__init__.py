"""Odometry: from scans and inertial samples to poses."""

from heliograph.odometry.filter.odometry import FilterOdometry
from heliograph.odometry.live import ImuRatePose, LiveOdometry
from heliograph.odometry.loam.odometry import LoamOdometry
from heliograph.odometry.pose_result import pose_result
from heliograph.odometry.poses_of_file import PoseFileOdometry
from heliograph.odometry.protocol import Odometry
from heliograph.odometry.registry import (
    ODOMETRIES,
    OdometryFactory,
    find_odometry,
    make_odometry,
    odometry_names,
    register_odometry,
)

__all__ = [
    "ODOMETRIES",
    "FilterOdometry",
    "ImuRatePose",
    "LiveOdometry",
    "LoamOdometry",
    "Odometry",
    "OdometryFactory",
    "PoseFileOdometry",
    "find_odometry",
    "make_odometry",
    "odometry_names",
    "pose_result",
    "register_odometry",
]
