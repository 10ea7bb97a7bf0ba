"""Calibration between sensors."""

from heliograph.calibration.lidar_imu import Calibration, calibrate
from heliograph.calibration.mounting import MountingAlignment, align_mounting
from heliograph.calibration.noise import NoiseCalibration, calibrate_noise

__all__ = [
    "Calibration",
    "MountingAlignment",
    "NoiseCalibration",
    "align_mounting",
    "calibrate",
    "calibrate_noise",
]
