"""How far the map itself may have drifted, and what that does to a state that is known among its planes.

The filter's covariance is conditional on the map: it says how well the pose is known among the planes around it. Those
planes were placed by earlier poses with errors of their own, and matching against them cannot tell. What a scan adds to
the map inherits the error of its pose, in one of two ways.

*Where the map sees*, new planes are a small share ``s`` of what the next scans are matched to. The frame that the map
defines walks randomly, with a step of ``s P`` for every new piece, P being its pose's covariance. Walking on over known
ground adds nothing. Coming back to old ground would take drift away again; the walk does not credit that, so the
account is cautious after a loop.

*Where it does not see*, in a tunnel along its axis, the map says nothing about where its frame is, and the next plane
that does will have been placed by the pose of then. There the frame goes with the pose: all of the pose's error becomes
the frame's, and the pose is exact in it. The two stay correlated (a velocity that is off has moved the frame and goes
on doing so), which is kept along.

A frame that turns leaves gravity and velocity behind, so in the frame they turn the other way.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array
from heliograph.data import NavState
from heliograph.data.error_layout import GRAVITY, POSE, POSE_DIM, POSITION, ROTATION, VELOCITY
from heliograph.imu import ErrorGrowth
from heliograph.lie import s2, so3
from heliograph.odometry.filter.lasting import Drag
from heliograph.snapshots import Stateful, array

__all__ = ["MapDrift"]


class MapDrift(Stateful):
    """Covariance of the local map's frame against the odom frame's origin, and with the state's errors.

    Parameters
    ----------
    systematic : float
        What does not average out within a scan, as a share of one match's error: however many matches, a scan's pose is
        known no better than from ``1 / systematic^2`` independent ones an axis.
    """

    _STATE: ClassVar = {
        "_frame": array(np.float64, POSE_DIM, POSE_DIM),
        "_lasting": array(np.float64, POSE_DIM, 3),
        "_cross": (array(np.float64, None, POSE_DIM), None),
        "_pending": float,
        "walked": float,
    }

    def __init__(self, systematic: float) -> None:
        self._systematic = systematic
        self._frame = np.zeros((POSE_DIM, POSE_DIM))
        self._cross: Array | None = (
            None  # of the state's errors with the frame's, (K, 6); None: nothing was handed over
        )
        self._lasting = np.zeros((POSE_DIM, 3))  # covariance of the frame's errors with what lasts
        self._pending = 0.0
        self.walked = 0.0
        """Variance by which the frame has walked where the sensor was, step by step since the beginning [m^2]."""

    def predicted(self, growth: ErrorGrowth) -> None:
        """Carry the correlation with the state on over a prediction."""
        if self._cross is not None:
            self._cross = growth.carried(self._cross)

    def updated(self, retained: Array) -> None:
        """Carry it on over an update that left ``retained`` (K, K) of the state's errors."""
        if self._cross is not None:
            self._cross = retained @ self._cross

    def hand_over(self, state: NavState, blind: Array) -> NavState:
        """Make the frame go with the pose along what the map does not see; return the state in the frame then.

        ``blind`` (6, 6) projects an error of the pose onto that.
        """
        dim = len(state.covariance)
        cross = self._cross if self._cross is not None else np.zeros((dim, POSE_DIM))
        given = np.zeros((POSE_DIM, dim))
        given[:, POSE] = _frame_by_pose(state) @ blind
        kept = np.eye(dim) + turned_frame(state) @ blind @ np.eye(POSE_DIM, dim)
        kept[POSE, POSE] -= blind
        P = state.covariance
        shared = given @ cross
        self._frame = self._frame + given @ P @ given.T + shared + shared.T
        self._cross = kept @ (cross + P @ given.T)
        covariance = kept @ P @ kept.T
        self.walked += max(float(np.trace((blind @ P[POSE, POSE] @ blind.T)[POSITION, POSITION])), 0.0)
        return replace(state, covariance=0.5 * (covariance + covariance.T))

    def begin(self, share: float) -> None:
        """Account for a scan that was not matched: its pose is exact by definition.

        What it added to the map, the ``share`` that was new, counts at the first pose that leans on it.
        """
        self._pending += share

    def grow(self, state: NavState, share: float, unit_covariance: Array) -> NavState:
        """Account for a matched scan of which ``share`` was new to the map; return the state in the frame then.

        ``unit_covariance`` (6, 6) is that of a pose matched with one independent match an axis.
        """
        step = (self._pending + share) * (state.covariance[POSE, POSE] + self._systematic**2 * unit_covariance)
        self._pending = 0.0
        N, turned = _frame_by_pose(state), turned_frame(state)
        self._frame = self._frame + N @ step @ N.T
        if self._cross is None:
            self._cross = np.zeros((len(turned), POSE_DIM))
        self._cross = self._cross + turned @ step @ N.T
        self.walked += float(np.trace(step[POSITION, POSITION]))
        return replace(state, covariance=state.covariance + turned @ step @ turned.T)

    def drag(self, drag: Drag) -> None:
        """Let the frame follow what scans err alike; see `LastingErrors`."""
        gain = np.zeros((POSE_DIM, 3))
        gain[POSITION] = drag.gain
        shared = gain @ self._lasting.T
        step = shared + shared.T + gain @ gain.T
        self._frame = self._frame + step
        self._lasting = drag.kept * (self._lasting + gain)
        self.walked += max(float(np.trace(step[POSITION, POSITION])), 0.0)

    def pose_covariance(self, state: NavState) -> Array:
        """Return the covariance of rotation (body) and position (odom) of ``state`` against the odom origin, (6, 6)."""
        N = np.linalg.inv(_frame_by_pose(state))
        total = state.covariance[POSE, POSE] + N @ self._frame @ N.T
        if self._cross is not None:
            shared = self._cross[POSE] @ N.T
            total = total + shared + shared.T
        return np.asarray(0.5 * (total + total.T))


def turned_frame(state: NavState) -> Array:
    """Return what handing an error of the pose (6) over to the frame does to velocity and gravity in it, (K, 6)."""
    turned = np.zeros((len(state.covariance), POSE_DIM))
    R = state.R_odom_imu
    turned[VELOCITY, ROTATION] = so3.hat(state.v_odom) @ R
    magnitude = float(np.linalg.norm(state.g_odom))
    if magnitude > 0.0:
        down = state.g_odom / magnitude
        turned[GRAVITY, ROTATION] = s2.basis(down).T @ so3.hat(down) @ R
    return turned


def _frame_by_pose(state: NavState) -> Array:
    """Return d (rotation, translation of the frame about its origin) / d (rotation in body, position), (6, 6)."""
    M = np.eye(6)
    M[ROTATION, ROTATION] = state.R_odom_imu
    M[POSITION, ROTATION] = so3.hat(state.p_odom) @ state.R_odom_imu
    return M
