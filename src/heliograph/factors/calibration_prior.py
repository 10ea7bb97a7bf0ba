"""What was believed of a mounting and a clock beforehand."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array
from heliograph.graph import Factor
from heliograph.lie import SE3, so3

__all__ = ["CalibrationPrior"]


class CalibrationPrior(Factor):
    """A joint prior of a mounting (SE3) and a clock (2), so that one direction that mixes both can be held.

    ``r = (phi, l - l_0, clock - clock_0)`` with ``R = exp(phi) R_0``: rotation about and lever arm along the axes of
    the imu [rad], [m], offset [s], drift [s/s]. Data are E_0 = (R_0, l_0) as (N, 4, 4), and clock_0 (N, 2).
    """

    __slots__ = ()

    variables = (SE3, 2)
    rows = 8

    @staticmethod
    def residual(E: Array, clock: Array, E_0: Array, clock_0: Array) -> Array:
        """Return the differences to the prior (N, 8)."""
        phi = so3.log(E[:, :3, :3] @ np.swapaxes(E_0[:, :3, :3], -1, -2))
        return np.concatenate([phi, E[:, :3, 3] - E_0[:, :3, 3], clock - clock_0], axis=1)

    @staticmethod
    def jacobians(E: Array, clock: Array, E_0: Array, clock_0: Array) -> tuple[Array, Array]:  # noqa: ARG004
        """Return the derivatives by the mounting (N, 8, 6) and the clock (N, 8, 2)."""
        R = E[:, :3, :3]
        phi = so3.log(R @ np.swapaxes(E_0[:, :3, :3], -1, -2))
        by_mounting = np.zeros((len(E), 8, 6))
        by_mounting[:, :3, :3] = so3.left_jacobian_inverse(phi) @ R
        by_mounting[:, 3:6, 3:] = R
        by_clock = np.zeros((len(E), 8, 2))
        by_clock[:, 6:] = np.eye(2)
        return by_mounting, by_clock
