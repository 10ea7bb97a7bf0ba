"""Frozen records that the rooms exchange. No algorithms live here."""

from heliograph.data.clock import ImuClock
from heliograph.data.event import Event
from heliograph.data.gnss import GnssFix
from heliograph.data.gnss_account import Georeference, GnssAccount, JudgedFix
from heliograph.data.graph_account import GraphAccount
from heliograph.data.imu import ImuBatch, ImuNoise
from heliograph.data.imu_record import ImuRecord
from heliograph.data.keyframe import Keyframe
from heliograph.data.nav_state import NavState
from heliograph.data.online_calibration import OnlineCalibration
from heliograph.data.repair import SensorRepair
from heliograph.data.result import ScanResult, ScanStatus
from heliograph.data.rig import Rig
from heliograph.data.scan import Scan
from heliograph.data.source import Message, Source
from heliograph.data.start import StartAccount
from heliograph.data.trajectory import Trajectory
from heliograph.data.wheels import WheelAccount, WheelSpeeds

__all__ = [
    "Event",
    "Georeference",
    "GnssAccount",
    "GnssFix",
    "GraphAccount",
    "ImuBatch",
    "ImuClock",
    "ImuNoise",
    "ImuRecord",
    "JudgedFix",
    "Keyframe",
    "Message",
    "NavState",
    "OnlineCalibration",
    "Rig",
    "Scan",
    "ScanResult",
    "ScanStatus",
    "SensorRepair",
    "Source",
    "StartAccount",
    "Trajectory",
    "WheelAccount",
    "WheelSpeeds",
]
