"""Sensor factors: what an IMU, a LiDAR and a satellite receiver measure, as factors of the graph."""

from heliograph.factors.calibration_prior import CalibrationPrior
from heliograph.factors.lidar_pose import LidarPose

__all__ = ["CalibrationPrior", "LidarPose"]
