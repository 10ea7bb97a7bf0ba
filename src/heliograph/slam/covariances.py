"""Covariances of poses and of the steps between them, as the graph wants them.

The graph's perturbation is ``T exp(xi)``, rotation and translation along body axes; the filter's errors are a rotation
about body axes and a position along odom axes.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, Stamps
from heliograph.lie import se3, so3
from heliograph.slam.growing_rows import GrowingRows
from heliograph.snapshots import PART, Stateful

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


class OdometryChain(Stateful):
    """How uncertain the odometry leaves the way from any keyframe to any other: the steps between add up."""

    _STATE: ClassVar = {"_stamps": PART, "_poses": PART, "_steps": PART, "_sums": PART}

    def __init__(self) -> None:
        self._stamps = GrowingRows(dtype=np.int64)
        self._poses, self._steps = GrowingRows(4, 4), GrowingRows(6, 6)
        self._sums = GrowingRows(6, 6)  # of left perturbations in odom, from the first keyframe on

    def __len__(self) -> int:
        return len(self._poses.all)

    def append(self, stamp_ns: int, T_odom_imu: Array, step: Array) -> None:
        """Add a keyframe's time [ns] and pose (4, 4), and the covariance of the step to it (6, 6)."""
        Ad = se3.adjoint(T_odom_imu)
        last = self._sums.all[-1] if len(self) else np.zeros((6, 6))
        self._sums.append(last + Ad @ step @ Ad.T)
        self._stamps.append(stamp_ns)
        self._steps.append(step)
        self._poses.append(T_odom_imu)

    @property
    def stamps_ns(self) -> Stamps:
        """All times, (K,) [ns]."""
        return self._stamps.all

    @property
    def step_covariances(self) -> Array:
        """Covariances of the steps to each keyframe, (K, 6, 6); that of the first is zero."""
        return self._steps.all

    @property
    def T_odom_imu(self) -> Array:
        """All poses, (K, 4, 4)."""
        return self._poses.all

    def pose(self, index: int) -> Array:
        """Return a keyframe's pose (4, 4)."""
        return np.asarray(self._poses.all[index])

    def relative(self, i: int, j: int) -> tuple[Array, Array]:
        """Return ``T_i_j`` (4, 4) by the odometry, and the covariance of a right perturbation of it (6, 6)."""
        # Asked for ten thousand times a minute where a place is revisited: the groups' checks would take most of it.
        A, B = self._poses.all[i], self._poses.all[j]
        R, p = B[:3, :3].T, B[:3, 3]
        Ad = np.zeros((6, 6))
        Ad[:3, :3] = Ad[3:, 3:] = R
        Ad[3:, :3] = R @ [[0.0, p[2], -p[1]], [-p[2], 0.0, p[0]], [p[1], -p[0], 0.0]]
        between = self._sums.all[j] - self._sums.all[i]
        T = np.eye(4)
        T[:3, :3] = A[:3, :3].T @ B[:3, :3]
        T[:3, 3] = A[:3, :3].T @ (p - A[:3, 3])
        return T, np.asarray(Ad @ (between if i <= j else -between) @ Ad.T)

    def variances(self, here: int, j: int, first: int, last: int) -> Array:
        """Return what the way from keyframes ``first`` to ``last`` - 1 to j leaves open, seen at another, (N, 6).

        Parameters
        ----------
        here : int
            Keyframe whose position the errors are carried to: a turn moves what is far from where it happened.
        j, first, last : int
            Keyframes.

        Returns
        -------
        (N, 6) float64
            Variances of rotation and position about and along odom's axes [rad^2, m^2].
        """
        weights = _axis_weights(self.pose(here)[:3, 3])
        sums = self._sums.all
        return np.asarray(np.abs(sums[first:last].reshape(-1, 36) @ weights - sums[j].reshape(36) @ weights))

    def variances_of(self, here: int, at: int, covariance: Array) -> Array:
        """Return the variances (6,) as `variances` does, of a right perturbation (6, 6) of a keyframe's pose."""
        Ad = se3.adjoint(self.pose(at))
        return np.asarray((Ad @ covariance @ Ad.T).reshape(36) @ _axis_weights(self.pose(here)[:3, 3]))


def _axis_weights(p_odom: Array) -> Array:
    """Return (36, 6): a covariance of left perturbations times it gives the variances of rotation and position there.

    With d the perturbation, a point p moves by ``d_position - hat(p) d_rotation``; its variance along an axis is linear
    in the covariance, and so is one product for any number of them.
    """
    J = np.eye(6)
    J[3:, :3] = -so3.hat(p_odom)
    return np.asarray(np.einsum("ai,aj->ija", J, J).reshape(36, 6))
