"""Sensor factors of the graph."""

from heliograph.factors.lidar_pose import LidarPose

__all__ = ["LidarPose"]
