"""A LiDAR's pose as a measurement of the IMU's motion, the mounting and the clock."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.graph import Factor
from heliograph.lie import SE3, ExtendedPose, se3, so3

__all__ = ["LidarPose"]


class LidarPose(Factor):
    """A registered sweep: ``r = Log(Z^-1 X(c) E)``, eq. (3) of docs/theory/calibration.md.

    Z is the measured ``T_odom_lidar``, E the mounting ``T_imu_lidar``. X is the motion at the instant of the sweep as
    the clock was estimated when the inertial samples were integrated; X(c) carries it along its own rate and velocity
    by what the clock has changed since, ``c = offset + span drift``, so that the factor stays exact while c is small
    against the motion's own times.

    Variables are the state (ExtendedPose, odom), the mounting (SE3) and the change of the clock (2): offset [s] and
    drift [s/s]. Data are Z (N, 4, 4), the body rate at X (N, 3) [rad/s] and the time since the clock's reference
    (N,) [s]. Rows: rotation, position, both in the measured lidar frame [rad], [m].
    """

    __slots__ = ()

    variables = (ExtendedPose, SE3, 2)
    rows = 6

    @staticmethod
    def residual(X: Array, E: Array, clock: Array, Z: Array, omega_imu: Array, span: Array) -> Array:
        """Return the difference between predicted and measured pose (N, 6)."""
        return se3.log(se3.inverse(Z) @ _moved(X, clock, omega_imu, span) @ E)

    @staticmethod
    def jacobians(
        X: Array, E: Array, clock: Array, Z: Array, omega_imu: Array, span: Array
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives by the state (N, 6, 9), the mounting (N, 6, 6) and the clock (N, 6, 2)."""
        moved = _moved(X, clock, omega_imu, span)
        by_mounting = se3.right_jacobian_inverse(se3.log(se3.inverse(Z) @ moved @ E))
        by_pose = by_mounting @ se3.adjoint(se3.inverse(E))
        later = _later(clock, span)
        back = np.swapaxes(so3.exp(later[:, None] * omega_imu), -1, -2)
        turned = np.zeros((len(X), 6, 9))  # of the moved pose by the state
        turned[:, :3, :3] = back
        turned[:, 3:, 3:6] = back
        turned[:, 3:, 6:9] = later[:, None, None] * back
        twist = np.concatenate([omega_imu, np.einsum("nji,nj->ni", moved[:, :3, :3], X[:, :3, 4])], axis=1)
        by_time = (by_pose @ twist[:, :, None])[:, :, 0]
        by_clock = np.stack([by_time, span[:, None] * by_time], axis=2)
        return by_pose @ turned, by_mounting, by_clock


def _later(clock: Array, span: Array) -> Array:
    return np.asarray(clock[:, 0] + span * clock[:, 1])


def _moved(X: Array, clock: Array, omega_imu: Array, span: Array) -> Array:
    """Return the poses (N, 4, 4) a little later, at constant body rate and velocity."""
    later = _later(clock, span)[:, None]
    R = X[:, :3, :3] @ so3.exp(later * omega_imu)
    return se3.from_rotation_translation(R, X[:, :3, 3] + later * X[:, :3, 4])
