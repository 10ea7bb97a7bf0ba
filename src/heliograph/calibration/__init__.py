"""Calibration between sensors."""

from heliograph.calibration.mounting import MountingAlignment, align_mounting

__all__ = ["MountingAlignment", "align_mounting"]
