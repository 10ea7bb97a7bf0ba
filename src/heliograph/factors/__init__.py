"""Sensor factors: what an inertial unit, a LiDAR and a satellite receiver measure, as factors of the graph."""

from heliograph.factors.calibration_prior import CalibrationPrior
from heliograph.factors.gravity import GravityDirection, GravityVector
from heliograph.factors.inertial import CombinedImu, PreintegratedImu
from heliograph.factors.lidar_pose import LidarPose
from heliograph.factors.mean_force import MeanForce
from heliograph.factors.positions import AnchoredPosition, LeverArmPosition, ScaledMotion, Velocity
from heliograph.graph.model.records import NativeRecord

__all__ = [
    "SENSOR_FACTORS",
    "AnchoredPosition",
    "CalibrationPrior",
    "CombinedImu",
    "GravityDirection",
    "GravityVector",
    "LeverArmPosition",
    "LidarPose",
    "MeanForce",
    "PreintegratedImu",
    "ScaledMotion",
    "Velocity",
]

SENSOR_FACTORS: tuple[type[NativeRecord], ...] = (
    AnchoredPosition,
    CalibrationPrior,
    CombinedImu,
    LeverArmPosition,
    LidarPose,
    MeanForce,
    PreintegratedImu,
    ScaledMotion,
    Velocity,
)
"""All classes of this room: what `load_graph` needs to read files that hold such factors."""
