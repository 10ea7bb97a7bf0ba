"""The error state: how a correction is applied to a navigation state, and how two states differ.

`heliograph.data.error_layout` says which error stands where.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heliograph.arrays import Array
from heliograph.data import NavState
from heliograph.data.error_layout import (
    ACCEL_BIAS,
    CLOCK,
    DRIFT,
    GRAVITY,
    GYRO_BIAS,
    LEVER_ARM,
    MOUNTING,
    MOUNTING_ROTATION,
    NAV_DIM,
    POSITION,
    ROTATION,
    VELOCITY,
    WHEEL_SCALE,
)
from heliograph.lie import s2, so3

__all__ = ["local", "mounting_error", "reset_jacobian", "retract"]


def retract(state: NavState, delta: Array) -> NavState:
    """Return ``state`` moved by errors ``delta`` (17,), (23,), (25,) or (26,); covariance and stamp are kept."""
    magnitude = float(np.linalg.norm(state.g_odom))
    g_odom = state.g_odom
    if magnitude > 0.0:
        g_odom = magnitude * s2.retract(state.g_odom / magnitude, delta[GRAVITY])
    T_imu_lidar = state.T_imu_lidar
    if len(delta) > NAV_DIM:
        T_imu_lidar = T_imu_lidar.copy()
        T_imu_lidar[:3, :3] = T_imu_lidar[:3, :3] @ so3.exp(delta[MOUNTING_ROTATION])
        T_imu_lidar[:3, 3] += delta[LEVER_ARM]
    late, faster = (float(delta[CLOCK]), float(delta[DRIFT])) if len(delta) > CLOCK else (0.0, 0.0)
    rescaled = float(delta[WHEEL_SCALE]) if len(delta) > WHEEL_SCALE else 0.0
    return replace(
        state,
        R_odom_imu=state.R_odom_imu @ so3.exp(delta[ROTATION]),
        p_odom=state.p_odom + delta[POSITION],
        v_odom=state.v_odom + delta[VELOCITY],
        gyro_bias=state.gyro_bias + delta[GYRO_BIAS],
        accel_bias=state.accel_bias + delta[ACCEL_BIAS],
        g_odom=g_odom,
        T_imu_lidar=T_imu_lidar,
        imu_offset=state.imu_offset + late,
        imu_drift=state.imu_drift + faster,
        wheel_scale=state.wheel_scale + rescaled,
    )


def local(origin: NavState, state: NavState) -> Array:
    """Return the error vector with ``retract(origin, delta) = state``."""
    delta = np.zeros(len(origin.covariance))
    delta[ROTATION] = so3.log(origin.R_odom_imu.T @ state.R_odom_imu)
    delta[POSITION] = state.p_odom - origin.p_odom
    delta[VELOCITY] = state.v_odom - origin.v_odom
    delta[GYRO_BIAS] = state.gyro_bias - origin.gyro_bias
    delta[ACCEL_BIAS] = state.accel_bias - origin.accel_bias
    magnitude = float(np.linalg.norm(origin.g_odom))
    if magnitude > 0.0:
        delta[GRAVITY] = s2.local(origin.g_odom / magnitude, state.g_odom / np.linalg.norm(state.g_odom))
    if len(delta) > NAV_DIM:
        delta[MOUNTING] = mounting_error(origin.T_imu_lidar, state.T_imu_lidar)
    if len(delta) > CLOCK:
        delta[CLOCK] = state.imu_offset - origin.imu_offset
        delta[DRIFT] = state.imu_drift - origin.imu_drift
    if len(delta) > WHEEL_SCALE:
        delta[WHEEL_SCALE] = state.wheel_scale - origin.wheel_scale
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
    J[ROTATION, ROTATION] = so3.right_jacobian(delta[ROTATION])
    magnitude = float(np.linalg.norm(origin.g_odom))
    if magnitude > 0.0:
        direction = origin.g_odom / magnitude
        moved = s2.retract(direction, delta[GRAVITY])
        J[GRAVITY, GRAVITY] = s2.basis(moved).T @ s2.retract_jacobian(direction, delta[GRAVITY])
    if len(delta) > NAV_DIM:
        J[MOUNTING_ROTATION, MOUNTING_ROTATION] = so3.right_jacobian(delta[MOUNTING_ROTATION])
    return J
