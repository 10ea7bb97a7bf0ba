"""The error state: how a correction is applied to a navigation state, and how two states differ.

Order: rotation (right perturbation), position, velocity, gyro bias, accelerometer bias, gravity direction on S(2)
[, mounting rotation (right), lever arm [, offset of the IMU's clock at the state's stamp, its drift]].
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.data import NavState
from heliograph.lie import s2, so3

__all__ = ["CLOCK", "DRIFT", "MOUNTING", "NAV_DIM", "local", "mounting_error", "reset_jacobian", "retract"]

Array = NDArray[np.float64]

NAV_DIM = 17
MOUNTING = slice(17, 23)
CLOCK, DRIFT = 23, 24
"""Where the errors of mounting, clock offset and clock drift are, if the state has them."""


def retract(state: NavState, delta: Array) -> NavState:
    """Return ``state`` moved by the error vector ``delta`` (17,), (23,) or (25,); covariance and stamp are kept."""
    magnitude = float(np.linalg.norm(state.g_odom))
    g_odom = state.g_odom
    if magnitude > 0.0:
        g_odom = magnitude * s2.retract(state.g_odom / magnitude, delta[15:17])
    T_imu_lidar = state.T_imu_lidar
    if len(delta) > NAV_DIM:
        T_imu_lidar = T_imu_lidar.copy()
        T_imu_lidar[:3, :3] = T_imu_lidar[:3, :3] @ so3.exp(delta[17:20])
        T_imu_lidar[:3, 3] += delta[20:23]
    late, faster = (float(delta[CLOCK]), float(delta[DRIFT])) if len(delta) > CLOCK else (0.0, 0.0)
    return replace(
        state,
        R_odom_imu=state.R_odom_imu @ so3.exp(delta[0:3]),
        p_odom=state.p_odom + delta[3:6],
        v_odom=state.v_odom + delta[6:9],
        gyro_bias=state.gyro_bias + delta[9:12],
        accel_bias=state.accel_bias + delta[12:15],
        g_odom=g_odom,
        T_imu_lidar=T_imu_lidar,
        imu_offset=state.imu_offset + late,
        imu_drift=state.imu_drift + faster,
    )


def local(origin: NavState, state: NavState) -> Array:
    """Return the error vector with ``retract(origin, delta) = state``."""
    delta = np.zeros(len(origin.covariance))
    delta[0:3] = so3.log(origin.R_odom_imu.T @ state.R_odom_imu)
    delta[3:6] = state.p_odom - origin.p_odom
    delta[6:9] = state.v_odom - origin.v_odom
    delta[9:12] = state.gyro_bias - origin.gyro_bias
    delta[12:15] = state.accel_bias - origin.accel_bias
    magnitude = float(np.linalg.norm(origin.g_odom))
    if magnitude > 0.0:
        delta[15:17] = s2.local(origin.g_odom / magnitude, state.g_odom / np.linalg.norm(state.g_odom))
    if len(delta) > NAV_DIM:
        delta[MOUNTING] = mounting_error(origin.T_imu_lidar, state.T_imu_lidar)
    if len(delta) > CLOCK:
        delta[CLOCK] = state.imu_offset - origin.imu_offset
        delta[DRIFT] = state.imu_drift - origin.imu_drift
    return delta


def mounting_error(origin: Array, T_imu_lidar: Array) -> Array:
    """Return the error (6,) that leads from one mounting (4, 4) to another: rotation (right), lever arm."""
    turn = so3.log(origin[:3, :3].T @ T_imu_lidar[:3, :3])
    return np.concatenate([turn, T_imu_lidar[:3, 3] - origin[:3, 3]])


def reset_jacobian(origin: NavState, delta: Array) -> Array:
    """Return d local(retract(origin, delta), retract(origin, delta + e)) / d e at e = 0, (K, K).

    It carries a covariance of errors around ``origin`` to errors around ``retract(origin, delta)``.
    """
    J = np.eye(len(delta))
    J[0:3, 0:3] = so3.right_jacobian(delta[0:3])
    magnitude = float(np.linalg.norm(origin.g_odom))
    if magnitude > 0.0:
        direction = origin.g_odom / magnitude
        moved = s2.retract(direction, delta[15:17])
        J[15:17, 15:17] = s2.basis(moved).T @ s2.retract_jacobian(direction, delta[15:17])
    if len(delta) > NAV_DIM:
        J[17:20, 17:20] = so3.right_jacobian(delta[17:20])
    return J
