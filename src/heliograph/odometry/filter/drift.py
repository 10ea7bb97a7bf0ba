"""How far the map itself may have drifted.

The filter's covariance is conditional on the map: it says how well the pose is known among the planes around it. Those
planes were placed by earlier poses with errors of their own, and matching against them cannot tell. What a scan adds to
the map inherits the error of its pose; so the frame that the map defines does a random walk, with a step for every new
piece. A scan of which the share ``s`` is new adds ``s P`` to the frame's covariance, P being its pose's. Walking on
over known ground adds nothing. Coming back to old ground would take drift away again; the walk does not credit that, so
the account is cautious after a loop.
"""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.data import NavState
from heliograph.data.error_layout import POSE, POSITION, ROTATION
from heliograph.lie import so3

__all__ = ["MapDrift"]


_SYSTEMATIC_LEVER = 6.0
"""Distance at which a systematic turn and a systematic shift move points alike [m]."""


class MapDrift:
    """Covariance of the local map's frame against the odom frame's origin.

    Parameters
    ----------
    systematic : float
        Standard deviation of B in position, as a share of the range noise.
    """

    def __init__(self, systematic: float) -> None:
        self._systematic = systematic
        self._frame = np.zeros((6, 6))
        self._pending = 0.0

    def grow(self, state: NavState, share: float, *, sigma: float, matched: bool) -> None:
        """Account for a scan of which ``share`` was new to the map and whose pose was ``matched`` or just defined.

        ``sigma`` is the range noise across planes [m].
        """
        self._pending += share
        if not matched:
            return  # the first scan's pose is exact by definition: its map counts at the first pose that leans on it
        M = _frame_by_pose(state)
        position = self._systematic * sigma
        B = np.diag([(position / _SYSTEMATIC_LEVER) ** 2] * 3 + [position**2] * 3)
        self._frame += self._pending * M @ (state.covariance[POSE, POSE] + B) @ M.T
        self._pending = 0.0

    def pose_covariance(self, state: NavState) -> Array:
        """Return the covariance of rotation (body) and position (odom) of ``state`` against the odom origin, (6, 6)."""
        N = np.linalg.inv(_frame_by_pose(state))
        total = state.covariance[POSE, POSE] + N @ self._frame @ N.T
        return np.asarray(0.5 * (total + total.T))


def _frame_by_pose(state: NavState) -> Array:
    """Return d (rotation, translation of the frame about its origin) / d (rotation in body, position), (6, 6)."""
    M = np.eye(6)
    M[ROTATION, ROTATION] = state.R_odom_imu
    M[POSITION, ROTATION] = so3.hat(state.p_odom) @ state.R_odom_imu
    return M
