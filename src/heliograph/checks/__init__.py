"""The failure checks: records in, findings with verdict, numbers and remedy out."""

from heliograph.checks.imu import IMU_CHECKS, check_imu
from heliograph.checks.records import (
    VERDICTS,
    CheckedMotion,
    CheckReport,
    Finding,
    ImuRecord,
    Number,
    worst,
)

__all__ = [
    "IMU_CHECKS",
    "VERDICTS",
    "CheckReport",
    "CheckedMotion",
    "Finding",
    "ImuRecord",
    "Number",
    "check_imu",
    "worst",
]
