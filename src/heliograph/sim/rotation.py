"""Roll, pitch and yaw to matrices: how scenarios and worlds say where a thing points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["euler_to_matrix", "rigid"]


def euler_to_matrix(angles: ArrayLike) -> NDArray[np.float64]:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Parameters
    ----------
    angles : (..., 3) float64
        Roll, pitch, yaw [rad].

    Returns
    -------
    (..., 3, 3) float64
    """
    roll, pitch, yaw = np.moveaxis(np.asarray(angles, dtype=np.float64), -1, 0)
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    R = np.empty((*np.shape(roll), 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -sp, cp * sr, cp * cr
    return R


def rigid(R: NDArray[np.float64], translation: ArrayLike) -> NDArray[np.float64]:
    """Return the 4 x 4 transform with rotation ``R`` and ``translation`` [m]."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = translation
    return T
