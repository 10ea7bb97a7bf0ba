"""Slow, obvious twin of preintegration: the midpoint rule on given readings, for many drawn ones at once."""

import numpy as np
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
