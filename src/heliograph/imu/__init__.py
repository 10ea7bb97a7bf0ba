"""Inertial model: start, propagation and preintegration."""

from heliograph.imu.motion_start import Excitation, MotionStart, align_motion
from heliograph.imu.preintegration import Preintegration, preintegrate
from heliograph.imu.propagation import ImuPath, propagate
from heliograph.imu.static_start import StaticStart, assess_stillness

__all__ = [
    "Excitation",
    "ImuPath",
    "MotionStart",
    "Preintegration",
    "StaticStart",
    "align_motion",
    "assess_stillness",
    "preintegrate",
    "propagate",
]
