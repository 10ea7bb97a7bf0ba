"""Inertial model: start and propagation."""

from heliograph.imu.motion_start import Excitation, MotionStart, align_motion
from heliograph.imu.propagation import ImuPath, propagate
from heliograph.imu.static_start import StaticStart, assess_stillness

__all__ = [
    "Excitation",
    "ImuPath",
    "MotionStart",
    "StaticStart",
    "align_motion",
    "assess_stillness",
    "propagate",
]
