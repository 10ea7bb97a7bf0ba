"""Quaternions of files and messages (xyzw) to rotation matrices and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["invert_pose", "quaternions_from_rotations", "rotations_from_quaternions"]


def invert_pose(T_a_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ``(4, 4)`` ``T_b_a`` of a rigid transform."""
    T_b_a = np.eye(4)
    T_b_a[:3, :3] = T_a_b[:3, :3].T
    T_b_a[:3, 3] = -T_a_b[:3, :3].T @ T_a_b[:3, 3]
    return T_b_a


def rotations_from_quaternions(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ``(N, 3, 3)`` rotation matrices of ``(N, 4)`` quaternions xyzw of any length but zero."""
    q = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 0, 1] = 2 * (x * y - z * w)
    R[..., 0, 2] = 2 * (x * z + y * w)
    R[..., 1, 0] = 2 * (x * y + z * w)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 1, 2] = 2 * (y * z - x * w)
    R[..., 2, 0] = 2 * (x * z - y * w)
    R[..., 2, 1] = 2 * (y * z + x * w)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def quaternions_from_rotations(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(N, 4)`` unit quaternions xyzw with ``w >= 0`` of ``(N, 3, 3)`` rotation matrices.

    Of the four equivalent formulas the one with the largest divisor is taken for each matrix, so that no digits are
    lost at any angle (Shepperd, "Quaternion from rotation matrix", 1978).
    """
    d = R[:, (0, 1, 2), (0, 1, 2)]
    trace = d.sum(axis=1)
    # Row c of `products` is 4 q_c * (x, y, z, w): each row is proportional to the quaternion.
    products = np.empty((len(R), 4, 4))
    for i in range(3):
        products[:, i, i] = 1 + 2 * d[:, i] - trace
    products[:, 3, 3] = 1 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, i, j] = products[:, j, i] = R[:, j, i] + R[:, i, j]
        products[:, k, 3] = products[:, 3, k] = R[:, j, i] - R[:, i, j]
    best = np.argmax(np.diagonal(products, axis1=1, axis2=2), axis=1)
    q = products[np.arange(len(R)), best]
    q *= np.where(q[:, 3:] < 0, -1.0, 1.0)
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))
