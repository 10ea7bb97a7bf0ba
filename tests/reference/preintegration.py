"""Slow, obvious twin of preintegration: the midpoint rule on given readings, for many drawn ones at once."""

import numpy as np
from scipy.linalg import logm
from scipy.spatial.transform import Rotation


def integrate_readings(gyro, accel, dt):
    """Return the extended poses (D, 5, 5) of readings (D, K, 3) in the middle of K steps of dt, without gravity."""
    draws, steps = gyro.shape[:2]
    X = np.tile(np.eye(5), (draws, 1, 1))
    for k in range(steps):
        half, whole = (Rotation.from_rotvec(share * dt * gyro[:, k]).as_matrix() for share in (0.5, 1.0))
        a = (X[:, :3, :3] @ half @ accel[:, k, :, None])[..., 0]
        X[:, :3, 3] += dt * X[:, :3, 4] + 0.5 * dt**2 * a
        X[:, :3, 4] += dt * a
        X[:, :3, :3] = X[:, :3, :3] @ whole
    return X


def motion_residual(X_i, X_j, motion, g):
    """Return ``Log(delta^-1 seen)`` (9,) of states (5, 5) for one preintegrated interval, as its equations stand."""
    T, late, twice = motion.duration_s[0], motion.gravity_s[0], motion.gravity_s2[0]
    fallen = X_i.copy()
    fallen[:3, 3] += T * X_i[:3, 4] + twice * g
    fallen[:3, 4] += late * g
    return log_extended(np.linalg.solve(motion.delta.matrix[0], np.linalg.solve(fallen, X_j)))


def log_extended(X):
    """Matrix logarithm of an extended pose as (rotation, position, velocity)."""
    L = np.real(logm(X))
    return np.concatenate([[L[2, 1], L[0, 2], L[1, 0]], L[:3, 3], L[:3, 4]])
