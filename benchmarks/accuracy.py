"""A trajectory against the truth, as the IMU's path, after the constant time shift that suits its rotation best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Trajectory
from heliograph.lie import se3
from heliograph.metrics import associate, change_body, evaluate

__all__ = ["SHIFT_LIMIT_S", "Accuracy", "accuracy", "evo_ate", "in_imu_frame"]

SHIFT_LIMIT_S = 0.06
_DELTA = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Errors after the best shift; ATE is after SE(3) alignment, RPE over 10 m."""

    poses: int
    shift_ms: float
    ate_m: float
    ate_max_m: float
    rotation_deg: float
    rpe_rotation_deg: float
    rpe_rotation_unshifted_deg: float
    rpe_translation_m: float
    gap_m: float


def in_imu_frame(trajectory: Trajectory, T_imu_lidar: NDArray[np.float64]) -> Trajectory:
    """Return the IMU's path for a trajectory of either sensor."""
    if trajectory.body == "imu":
        return trajectory
    return change_body(trajectory, se3.inverse(T_imu_lidar), body="imu")


def accuracy(estimate: Trajectory, truth: Trajectory, *, shift: str | float = "auto") -> Accuracy:
    """Return the errors of the IMU's path against the IMU's truth."""
    plain = evaluate(estimate, truth, delta=_DELTA)
    best = evaluate(estimate, truth, delta=_DELTA, time_offset=shift, offset_limit_s=SHIFT_LIMIT_S)
    return Accuracy(
        poses=best.poses_compared,
        shift_ms=best.time_offset * 1e3,
        ate_m=best.absolute.rmse,
        ate_max_m=best.absolute.max,
        rotation_deg=best.absolute.rotation_rmse_deg,
        rpe_rotation_deg=best.relative.rotation_rmse_deg,
        rpe_rotation_unshifted_deg=plain.relative.rotation_rmse_deg,
        rpe_translation_m=best.relative.translation_rmse,
        gap_m=best.start_end_gap,
    )


def evo_ate(estimate: Trajectory, truth: Trajectory, shift_s: float) -> float:
    """Return evo's ATE of the poses that `accuracy` interpolated: the same number from another program."""
    from evo.core import metrics, trajectory  # needed here only

    pair = associate(estimate, truth, time_offset=shift_s)
    reference, moved = (
        trajectory.PoseTrajectory3D(poses_se3=list(T), timestamps=pair.stamps_ns * 1e-9)
        for T in (pair.T_reference, pair.T_estimate)
    )
    moved.align(reference, correct_scale=False)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, moved))
    return float(error.get_statistic(metrics.StatisticsType.rmse))
