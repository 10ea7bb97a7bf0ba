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
from heliograph.checks.run_watch import RunWatch
from heliograph.checks.verdicts import RUN_CHECKS, VERDICT_WORDS, RunEvidence, check_run

__all__ = [
    "IMU_CHECKS",
    "RUN_CHECKS",
    "VERDICTS",
    "VERDICT_WORDS",
    "CheckReport",
    "CheckedMotion",
    "Finding",
    "ImuRecord",
    "Number",
    "RunEvidence",
    "RunWatch",
    "check_imu",
    "check_run",
    "worst",
]
