"""Calibration between sensors."""

from heliograph.calibration.lidar_imu import Calibration, calibrate
from heliograph.calibration.mounting import MountingAlignment, align_mounting

__all__ = ["Calibration", "MountingAlignment", "align_mounting", "calibrate"]
