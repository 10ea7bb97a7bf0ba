"""The levelled body frame: what gravity says is kept, what no keyframe can know alone (its heading) is taken out."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Points, as_points, as_pose
from heliograph.lie import se3, so3
from heliograph.maps import transformed

__all__ = ["body_guess", "level_points", "level_pose"]


def level_pose(T_odom_imu: Array) -> Array:
    """Return ``T_level_imu`` (4, 4): the body's tilt alone, its heading and position taken out.

    ``level`` has its origin at the body, z up and x along the body's horizontal heading (its x axis, or its y axis less
    90 degrees where x points up).
    """
    R = as_pose("T_odom_imu", T_odom_imu)[:3, :3]
    heading = np.arctan2(R[1, 0], R[0, 0]) if np.hypot(R[0, 0], R[1, 0]) > 0.1 else np.arctan2(-R[0, 1], R[1, 1])
    return se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, -float(heading)) @ R, np.zeros(3))


def level_points(points_imu: Points, T_odom_imu: Array) -> Points:
    """Return points (N, 3) float32 of a body frame in its levelled frame."""
    return transformed(as_points("points_imu", points_imu), level_pose(T_odom_imu))


def body_guess(T_match_query_level: Array, T_odom_match: Array, T_odom_query: Array) -> Array:
    """Return a detector's guess between levelled frames as one between the bodies, ``T_match_query`` (4, 4)."""
    match, query = level_pose(T_odom_match), level_pose(T_odom_query)
    return np.asarray(se3.inverse(match) @ as_pose("T_match_query_level", T_match_query_level) @ query)
