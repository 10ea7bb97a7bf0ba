"""All checks of an IMU, in the order in which causes precede consequences."""

from __future__ import annotations

from collections.abc import Callable

from heliograph.checks.agreement import check_clock_offset, check_prediction
from heliograph.checks.axes import check_accel_axes, check_gyro_axes, check_mounting
from heliograph.checks.evidence import Evidence, gather
from heliograph.checks.lever import check_lever_arm
from heliograph.checks.records import CheckedMotion, Finding, ImuRecord
from heliograph.checks.signals import check_channels, check_saturation, check_vibration
from heliograph.checks.stamps import (
    check_clock,
    check_gaps,
    check_jitter,
    check_order,
    check_rate,
    check_values,
)
from heliograph.checks.units import check_accel_unit, check_gyro_unit
from heliograph.config import CheckConfig

__all__ = ["IMU_CHECKS", "IN_RUN_CHECKS", "check_imu"]

IN_RUN_CHECKS: tuple[Callable[[Evidence], Finding], ...] = (
    check_channels,
    check_saturation,
    check_accel_unit,
    check_gyro_unit,
    check_clock_offset,
    check_gyro_axes,
    check_accel_axes,
    check_mounting,
    check_lever_arm,
    check_vibration,
    check_prediction,
)
"""Those that need no messages as they were recorded; stamps are the reader's to count."""

IMU_CHECKS: tuple[Callable[[Evidence], Finding], ...] = (
    check_values,
    check_clock,
    check_order,
    check_gaps,
    check_rate,
    check_jitter,
    *IN_RUN_CHECKS,
)
"""One function a check; of equally bad findings the earliest is the one to act on first."""


def check_imu(
    imu: ImuRecord, motion: CheckedMotion | None = None, why: str = "", *, config: CheckConfig | None = None
) -> tuple[Finding, ...]:
    """Run all checks of an IMU.

    Parameters
    ----------
    imu : ImuRecord
        As recorded.
    motion : CheckedMotion or None
        What the LiDAR alone saw; without it the checks that compare are ``unknown``.
    why : str
        Why there is none, for the findings.
    config : CheckConfig, optional
        From where on a finding warns or fails.

    Returns
    -------
    tuple of Finding
        One a check, in the order of `IMU_CHECKS`.
    """
    evidence = gather(
        imu, motion, why or ("" if motion is not None else "there is no LiDAR to compare with"), config=config
    )
    return tuple(check(evidence) for check in IMU_CHECKS)
