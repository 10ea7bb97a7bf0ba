"""Inertial model: start, propagation and preintegration."""

from heliograph.imu.preintegration import Preintegration, preintegrate
from heliograph.imu.propagation import ImuPath, propagate
from heliograph.imu.static_start import StaticStart, assess_stillness

__all__ = ["ImuPath", "Preintegration", "StaticStart", "assess_stillness", "preintegrate", "propagate"]
