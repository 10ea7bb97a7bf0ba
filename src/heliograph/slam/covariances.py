"""Covariances of poses and of the steps between them, as the graph wants them.

The graph's perturbation is ``T exp(xi)``, rotation and translation along body axes; the filter's errors are a rotation
about body axes and a position along odom axes.
"""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Stamps
from heliograph.lie import se3

__all__ = ["OdometryChain", "graph_covariance", "graph_information", "step_covariance"]

_LEVER = 10.0  # distance at which a radian is compared with a metre [m]


def graph_covariance(pose_covariance: Array, T_odom_imu: Array) -> Array:
    """Return the covariance of a right perturbation (6, 6) from that of rotation (body) and position (odom).

    Parameters
    ----------
    pose_covariance : (6, 6) float64
        As in `ScanResult`.
    T_odom_imu : (4, 4) float64
    """
    M = np.eye(6)
    M[3:, 3:] = T_odom_imu[:3, :3].T
    return np.asarray(M @ pose_covariance @ M.T)


def graph_information(information: Array, T_odom_imu: Array) -> Array:
    """Return the information about a right perturbation (6, 6) from that about rotation (body) and position (odom)."""
    M = np.eye(6)
    M[3:, 3:] = T_odom_imu[:3, :3]
    return np.asarray(M.T @ information @ M)


def step_covariance(T_before: Array, T_after: Array, before: Array, after: Array, least: Array) -> Array:
    """Return the covariance of a step, (6, 6), a right perturbation of ``inverse(T_before) @ T_after``.

    The error of the later pose is the earlier one's, carried along, and the step's: what the covariance has grown by.
    Where it has shrunk, as the odometry found more to hold on to, the step is taken to add nothing beyond the least.

    Parameters
    ----------
    T_before, T_after : (4, 4) float64
        Poses in one frame.
    before, after : (6, 6) float64
        Covariances of right perturbations of them.
    least : (6,) float64
        Standard deviations that a step has at least [rad], [m].
    """
    carry = se3.adjoint(se3.inverse(T_after) @ T_before)
    grown = after - carry @ before @ carry.T
    scale = np.array([_LEVER] * 3 + [1.0] * 3)
    values, vectors = np.linalg.eigh(scale[:, None] * (0.5 * (grown + grown.T)) * scale)
    kept = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(kept / scale[:, None] / scale + np.diag(least**2))


class OdometryChain:
    """How uncertain the odometry leaves the way from any keyframe to any other: the steps between add up."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[Array] = []
        self._steps: list[Array] = []
        self._sums: list[Array] = []  # of left perturbations in odom, from the first keyframe on

    def __len__(self) -> int:
        return len(self._poses)

    def append(self, stamp_ns: int, T_odom_imu: Array, step: Array) -> None:
        """Add a keyframe's time [ns] and pose (4, 4), and the covariance of the step to it (6, 6)."""
        Ad = se3.adjoint(T_odom_imu)
        last = self._sums[-1] if self._sums else np.zeros((6, 6))
        self._stamps.append(stamp_ns)
        self._steps.append(step)
        self._poses.append(np.asarray(T_odom_imu))
        self._sums.append(last + Ad @ step @ Ad.T)

    @property
    def stamps_ns(self) -> Stamps:
        """All times, (K,) [ns]."""
        return np.array(self._stamps, dtype=np.int64)

    @property
    def step_covariances(self) -> Array:
        """Covariances of the steps to each keyframe, (K, 6, 6); that of the first is zero."""
        return np.stack(self._steps) if self._steps else np.zeros((0, 6, 6))

    @property
    def T_odom_imu(self) -> Array:
        """All poses, (K, 4, 4)."""
        return np.stack(self._poses) if self._poses else np.zeros((0, 4, 4))

    def pose(self, index: int) -> Array:
        """Return a keyframe's pose (4, 4)."""
        return self._poses[index]

    def relative(self, i: int, j: int) -> tuple[Array, Array]:
        """Return ``T_i_j`` (4, 4) by the odometry, and the covariance of a right perturbation of it (6, 6)."""
        T = se3.inverse(self._poses[i]) @ self._poses[j]
        return np.asarray(T), self.relative_covariances(j, np.array([i]))[0]

    def relative_covariances(self, j: int, others: np.ndarray) -> Array:
        """Return the covariances of right perturbations of ``T_i_j`` for each keyframe i, (N, 6, 6)."""
        Ad = se3.adjoint(se3.inverse(self._poses[j]))
        sums = np.stack([self._sums[int(i)] for i in others])
        between = np.where((others <= j)[:, None, None], self._sums[j] - sums, sums - self._sums[j])
        return np.asarray(Ad @ between @ Ad.T)
