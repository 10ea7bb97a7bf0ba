"""Slow, obvious twins of the sensors' factors: one at a time, by matrices and the functions of `heliograph.lie`."""

import numpy as np
from scipy.linalg import expm

from heliograph.lie import s2, se3, se23, so3


def hat_extended(d):
    """The matrix (5, 5) whose exponential an extended pose is, of (rotation, position, velocity)."""
    L = np.zeros((5, 5))
    L[:3, :3] = so3.hat(d[:3])
    L[:3, 3], L[:3, 4] = d[3:6], d[6:9]
    return L


def corrected_motion(row, bias):
    """The preintegrated motion of a factor's row (92,), corrected to first order for a bias (6,)."""
    delta = np.eye(5)
    delta[:3, :3], delta[:3, 3], delta[:3, 4] = row[:9].reshape(3, 3), row[9:12], row[12:15]
    return delta @ expm(hat_extended(row[24:78].reshape(9, 6) @ (bias - row[18:24])))


def inertial_residual(X_i, X_j, expected, row, g):
    """``Log(expected^-1 seen)`` (9,), the motion seen being that between the states less gravity's."""
    fallen = X_i.copy()
    fallen[:3, 3] += row[15] * X_i[:3, 4] + row[17] * g
    fallen[:3, 4] += row[16] * g
    return se23.log(np.linalg.solve(expected, np.linalg.solve(fallen, X_j)))


def lever_arm(T, arm, z):
    return T[:3, 3] + T[:3, :3] @ arm - z


def anchored_position(T, frame, arm, z):
    return frame[:3, :3].T @ (T[:3, 3] + T[:3, :3] @ arm - frame[:3, 3]) - z


def scaled_motion(T_i, T_j, scale, arm, d):
    return T_i[:3, :3].T @ (T_j[:3, 3] + T_j[:3, :3] @ arm - T_i[:3, 3]) - arm - scale[0] * d


def mean_force(T, up, bias, z, turning):
    return T[:3, :3].T @ up + turning @ bias - z


def lidar_pose(X, E, clock, Z, omega, span):
    later = clock[0] + span * clock[1]
    moved = se3.from_rotation_translation(X[:3, :3] @ so3.exp(later * omega), X[:3, 3] + later * X[:3, 4])
    return se3.log(se3.inverse(Z) @ moved @ E)


def calibration_prior(E, clock, E_0, clock_0):
    return np.concatenate([so3.log(E[:3, :3] @ E_0[:3, :3].T), E[:3, 3] - E_0[:3, 3], clock - clock_0])


def attitude(T, world, z):
    return s2.local(z, T[:3, :3].T @ world)


def plane(T, normal, distance, z, z_distance):
    return np.append(s2.local(z, T[:3, :3].T @ normal), distance - normal @ T[:3, 3] - z_distance)


def point_to_plane(T, normal, distance, point):
    return normal @ (T[:3, :3] @ point + T[:3, 3]) - distance
