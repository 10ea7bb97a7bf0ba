"""Trajectory errors against a reference, and map sharpness without one."""

from heliograph.metrics.evaluate import Evaluation, evaluate
from heliograph.metrics.sharpness import MapSharpness, map_sharpness
from heliograph.metrics.trajectory import (
    ALIGNMENTS,
    AbsoluteError,
    Association,
    RelativeError,
    absolute_trajectory_error,
    align,
    align_poses,
    associate,
    best_time_offset,
    change_body,
    path_length,
    relative_pose_error,
    start_end_gap,
)

__all__ = [
    "ALIGNMENTS",
    "AbsoluteError",
    "Association",
    "Evaluation",
    "MapSharpness",
    "RelativeError",
    "absolute_trajectory_error",
    "align",
    "align_poses",
    "associate",
    "best_time_offset",
    "change_body",
    "evaluate",
    "map_sharpness",
    "path_length",
    "relative_pose_error",
    "start_end_gap",
]
