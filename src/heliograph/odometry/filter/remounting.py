"""A map made with a wrong mounting is bent; it is begun anew once the mounting is known better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heliograph.arrays import Array
from heliograph.data import NavState
from heliograph.data.error_layout import GRAVITY, MOUNTING, POSE, ROTATION, VELOCITY
from heliograph.lie import s2, so3
from heliograph.odometry.filter.error_state import mounting_error

__all__ = ["anchoring", "bend", "is_bent", "widened"]


# Such a change of the mounting is felt in the map: at 15 m it is a range's noise, and within a sweep a tenth of it.
_BENT_ROTATION, _BENT_LEVER = 5e-4, 0.003  # [rad], [m]
# A map restarted at every scan would hold nothing.
_MIN_SCANS = 5
# Scans inserted before a correction have bent the map towards the wrong mounting, so a correction falls short: in
# simulated runs by 0.1 to 0.3 of it in general motion, by 0.7 in planar motion. All of it counts as uncertain again.
_SHORTFALL = 1.0


def bend(T_map: Array, state: NavState) -> tuple[float, float]:
    """Return by how much the mounting differs from that of the map: angle [rad] and distance [m]."""
    error = mounting_error(T_map, state.T_imu_lidar)
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def is_bent(T_map: Array, state: NavState, scans: int) -> bool:
    """Whether a map of ``scans`` scans, made with the mounting ``T_map`` (4, 4), should be begun anew."""
    turn, shift = bend(T_map, state)
    return scans >= _MIN_SCANS and (turn > _BENT_ROTATION or shift > _BENT_LEVER)


def anchoring(state: NavState) -> Array:
    """Return the derivative (K, K) of the errors in a frame in which the pose is exact, by those before.

    What was uncertain about the rotation is then uncertain about velocity and gravity, which turn with the frame.
    """
    M = np.eye(len(state.covariance))
    M[POSE, POSE] = 0.0
    R = state.R_odom_imu
    M[VELOCITY, ROTATION] = R @ so3.hat(R.T @ state.v_odom)
    magnitude = float(np.linalg.norm(state.g_odom))
    if magnitude > 0.0:
        down = state.g_odom / magnitude
        M[GRAVITY, ROTATION] = s2.basis(down).T @ R @ so3.hat(R.T @ down)
    return M


def widened(state: NavState, T_map: Array, considered: Array) -> NavState:
    """Return the state with what a bent map leaves behind of the mounting's correction, where it may move."""
    turn, shift = bend(T_map, state)
    added = np.zeros_like(state.covariance)
    added[MOUNTING, MOUNTING] = np.diag(np.repeat([_SHORTFALL * turn, _SHORTFALL * shift], 3) ** 2)
    free = np.eye(len(added)) - considered
    return replace(state, covariance=state.covariance + free @ added @ free.T)
