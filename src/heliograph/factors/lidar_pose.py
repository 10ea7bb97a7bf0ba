"""A LiDAR's pose as a measurement of the IMU's motion, the mounting and the clock."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, vectors
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Noise
from heliograph.graph.model.records import NativeRecord, as_measurement, key_columns
from heliograph.lie import SE3, ExtendedPose

__all__ = ["LidarPose"]


class LidarPose(NativeRecord):
    """A registered sweep: ``r = Log(Z^-1 X(c) E)``, eq. (3) of docs/theory/calibration.md.

    Z is the measured ``T_odom_lidar``, E the mounting ``T_imu_lidar``. X is the motion at the instant of the sweep as
    the clock was estimated when the inertial samples were integrated; X(c) carries it along its own rate and velocity
    by what the clock has changed since, ``c = offset + span drift``, so that the factor stays exact while c is small
    against the motion's own times.

    Parameters
    ----------
    key : int or (N,) int
        Keys of the states, ExtendedPose, odom.
    mounting : int or (N,) int
        Key of the mounting, an SE3.
    clock : int or (N,) int
        Key of the change of the clock, a vector of dimension 2: offset [s] and drift [s/s].
    T_odom_lidar : SE3
        Measured.
    omega_imu : (3,) or (N, 3) float64
        Body rate at X [rad/s].
    span : float or (N,) float64
        Time since the clock's reference [s].
    noise : Noise
        Noise of six rows: rotation [rad], position [m], both in the measured lidar frame.
    kernel : Kernel, optional
        For robust costs.

    Raises
    ------
    GraphError
        Numbers that do not fit the keys.
    """

    __slots__ = ()
    type: ClassVar[int] = 68

    def __init__(
        self,
        key: ArrayLike,
        mounting: ArrayLike,
        clock: ArrayLike,
        T_odom_lidar: SE3,
        omega_imu: ArrayLike,
        span: ArrayLike,
        noise: Noise,
        *,
        kernel: Kernel | None = None,
    ) -> None:
        keys = key_columns("LidarPose", (key, mounting, clock))
        if not isinstance(T_odom_lidar, SE3):
            raise GraphError(f"LidarPose: a pose is an SE3, not a {type(T_odom_lidar).__name__}")
        pose = as_measurement("LidarPose", T_odom_lidar, len(keys))[0]
        rate = as_measurement("LidarPose", omega_imu, len(keys))[0]
        since = as_measurement("LidarPose", np.asarray(span, dtype=np.float64).reshape(-1, 1), len(keys))[0]
        if rate.shape[1] != 3:
            raise GraphError(f"LidarPose: body rates have 3 numbers, got {rate.shape[1]}")
        self._fill(
            keys=keys,
            measurement=np.concatenate([pose, rate, since], axis=1),
            measured=None,
            rows=6,
            noise=noise,
            kernel=kernel,
            allowed=((FAMILIES[ExtendedPose],), (FAMILIES[SE3],), (vectors(2),)),
        )
