"""Sensor factors: what an inertial unit, a LiDAR and a satellite receiver measure, as factors of the graph."""

from heliograph.factors.calibration_prior import CalibrationPrior
from heliograph.factors.gravity import GravityDirection, GravityVector
from heliograph.factors.inertial import CombinedImu, PreintegratedImu
from heliograph.factors.lidar_pose import LidarPose
from heliograph.factors.positions import LeverArmPosition, Velocity
from heliograph.graph.model.records import NativeRecord

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

SENSOR_FACTORS: tuple[type[NativeRecord], ...] = (
    CalibrationPrior,
    CombinedImu,
    LeverArmPosition,
    LidarPose,
    PreintegratedImu,
    Velocity,
)
"""All classes of this room: what `load_graph` needs to read files that hold such factors."""
