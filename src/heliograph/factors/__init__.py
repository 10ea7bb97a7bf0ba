"""Sensor factors: what an inertial unit, a LiDAR and a satellite receiver measure, as factors of the graph."""

from heliograph.factors.calibration_prior import CalibrationPrior
from heliograph.factors.gravity import GravityDirection, GravityVector
from heliograph.factors.inertial import (
    CombinedImu,
    CombinedImuOnDirection,
    CombinedImuOnGravity,
    PreintegratedImu,
    PreintegratedImuOnDirection,
    PreintegratedImuOnGravity,
)
from heliograph.factors.lidar_pose import LidarPose
from heliograph.factors.positions import LeverArmPosition, LeverArmPositionOnArm, Velocity
from heliograph.graph import Factor

__all__ = [
    "SENSOR_FACTORS",
    "CalibrationPrior",
    "CombinedImu",
    "GravityDirection",
    "GravityVector",
    "LeverArmPosition",
    "LidarPose",
    "PreintegratedImu",
    "Velocity",
]

SENSOR_FACTORS: tuple[type[Factor], ...] = (
    CalibrationPrior,
    CombinedImu,
    CombinedImuOnDirection,
    CombinedImuOnGravity,
    LeverArmPosition,
    LeverArmPositionOnArm,
    LidarPose,
    PreintegratedImu,
    PreintegratedImuOnDirection,
    PreintegratedImuOnGravity,
    Velocity,
)
"""All classes of this room: what `load_graph` and `ISAM2.load` need to read files that hold such factors."""
