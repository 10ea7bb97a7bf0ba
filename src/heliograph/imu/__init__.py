"""Inertial model: start and propagation."""

from heliograph.imu.propagation import ImuPath, propagate
from heliograph.imu.static_start import StaticStart, assess_stillness

__all__ = ["ImuPath", "StaticStart", "assess_stillness", "propagate"]
