"""Calibration between sensors."""

from heliograph.calibration.mounting import MountingAlignment, align_mounting
from heliograph.calibration.noise import NoiseCalibration, calibrate_noise

__all__ = ["MountingAlignment", "NoiseCalibration", "align_mounting", "calibrate_noise"]
