"""The failure checks: records in, findings with verdict, numbers and remedy out."""

from heliograph.checks.imu import IMU_CHECKS, check_imu
from heliograph.checks.records import (
    VERDICTS,
    CheckReport,
    Finding,
    ImuRecord,
    LidarMotion,
    Number,
    worst,
)

__all__ = [
    "IMU_CHECKS",
    "VERDICTS",
    "CheckReport",
    "Finding",
    "ImuRecord",
    "LidarMotion",
    "Number",
    "check_imu",
    "worst",
]
