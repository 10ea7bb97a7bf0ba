"""Inertial model: start, propagation and preintegration."""

from heliograph.imu.filled import drop_filled
from heliograph.imu.motion_start import ImuExcitation, MotionStart, align_motion
from heliograph.imu.position_start import PositionStart, start_from_positions
from heliograph.imu.preintegration import Preintegration, preintegrate
from heliograph.imu.propagation import ErrorGrowth, ImuPath, Prediction, predict, propagate
from heliograph.imu.static_start import StaticStart, assess_stillness

__all__ = [
    "ErrorGrowth",
    "ImuExcitation",
    "ImuPath",
    "MotionStart",
    "PositionStart",
    "Prediction",
    "Preintegration",
    "StaticStart",
    "align_motion",
    "assess_stillness",
    "drop_filled",
    "predict",
    "preintegrate",
    "propagate",
    "start_from_positions",
]
