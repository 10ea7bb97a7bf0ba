"""Slow, obvious twin of the native matching: each point asks the slow map, each residual adds its outer product."""

import numpy as np


def find_slowly(slow_map, q, gate, *, fallback):
    found = slow_map.plane_at(q, gate)
    return found if found is not None or not fallback else slow_map.neighbour_plane(q, gate)


def rows_slowly(p, n, T_odom_imu, T_imu_lidar, before_end, columns):
    """Derivative of n . (R p + t) by rotation, position, then (velocity, gyro bias) or the mounting's two."""
    R = T_odom_imu[:3, :3]
    m = R.T @ n
    pose = [np.cross(p, m), n]
    if columns == 6:
        return np.concatenate(pose)
    if before_end is not None:
        return np.concatenate([*pose, -before_end * n, before_end * pose[0]])
    R_il, t_il = T_imu_lidar[:3, :3], T_imu_lidar[:3, 3]
    return np.concatenate([*pose, np.cross(R_il.T @ (p - t_il), R_il.T @ m), m])


def sums_slowly(terms, columns, kernel):
    """Information, gradient, weight, robust weight, square, cost and count of terms (J rows, residuals, variance)."""
    A, b = np.zeros((columns, columns)), np.zeros(columns)
    weight = robust = square = cost = 0.0
    for J, r, variance in terms:
        r2 = float(r @ r)
        c2 = kernel**2
        w = (c2 / (c2 + r2)) ** 2 if kernel > 0.0 else 1.0
        rho = 0.5 * r2 * (c2 / (c2 + r2) if kernel > 0.0 else 1.0)
        A += w / variance * J.T @ J
        b += w / variance * J.T @ r
        rows = len(r)
        weight, robust, square = weight + rows * w / variance, robust + rows * w, square + w * r2
        cost += rho / variance
    return A, b, weight, robust, square, cost, len(terms)


def match_planes_slowly(slow_map, points, T_odom_imu, T_imu_lidar, *, gate, kernel, sigma, columns, before_end=None):
    terms, fallbacks = [], 0
    for i, p in enumerate(points.astype(np.float64)):
        q = T_odom_imu[:3, :3] @ p + T_odom_imu[:3, 3]
        found = find_slowly(slow_map, q, gate, fallback=True)
        if found is None:
            continue
        n, point, variance, source = found
        fallbacks += source == 255
        dt = None if before_end is None else before_end[i]
        J = rows_slowly(p, n, T_odom_imu, T_imu_lidar, dt, columns)
        terms.append((J[None], np.array([n @ (q - point)]), sigma**2 + variance))
    return *sums_slowly(terms, columns, kernel), fallbacks


def match_points_slowly(slow_map, points, T_odom_imu, T_imu_lidar, *, gate, kernel, sigma, columns, before_end=None):
    terms = []
    for i, p in enumerate(points.astype(np.float64)):
        q = T_odom_imu[:3, :3] @ p + T_odom_imu[:3, 3]
        near = slow_map.nearest(q, gate)
        if not near:
            continue
        dt = None if before_end is None else before_end[i]
        J = np.stack([rows_slowly(p, n, T_odom_imu, T_imu_lidar, dt, columns) for n in np.eye(3)])
        terms.append((J, q - near[0], sigma**2))
    return *sums_slowly(terms, columns, kernel), 0
