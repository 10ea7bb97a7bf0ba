"""Slow, obvious twin of the native matching: each point asks the slow map, each residual adds its outer product."""

import numpy as np


def find_slowly(slow_map, q, gate, *, fallback):
    found = slow_map.plane_at(q, gate)
    return found if found is not None or not fallback else slow_map.neighbour_plane(q, gate)


def pose_row(p, n, T_odom_imu):
    """Derivative of n . (R p + t) by rotation (right) and position."""
    return np.concatenate([np.cross(p, T_odom_imu[:3, :3].T @ n), n])


def motion_row(before_end, pose):
    """... by velocity and gyro bias: a point measured before the end was carried forward by both."""
    return np.concatenate([-before_end * pose[3:], before_end * pose[:3]])


def mounting_part(T_odom_imu, T_imu_lidar, q, n):
    """Derivative of n . q by the mounting's rotation (right) and lever arm, q being seen from the pose."""
    p_imu = T_odom_imu[:3, :3].T @ (q - T_odom_imu[:3, 3])
    p_lidar = T_imu_lidar[:3, :3].T @ (p_imu - T_imu_lidar[:3, 3])
    m = T_odom_imu[:3, :3].T @ n
    return np.concatenate([np.cross(p_lidar, T_imu_lidar[:3, :3].T @ m), m])


def mounting_row(n, q, T_odom_imu, T_imu_lidar, *, T_first, source):
    """... by the mounting: what its error does here less what it did at the map's first pose."""
    if source == 255:
        return np.zeros(6)
    return mounting_part(T_odom_imu, T_imu_lidar, q, n) - mounting_part(T_first, T_imu_lidar, q, n)


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


def match_planes_slowly(
    slow_map, points, T_odom_imu, *, gate, kernel, sigma, before_end=None, T_imu_lidar=None, T_first=None
):
    terms, fallbacks = [], 0
    for i, p in enumerate(points.astype(np.float64)):
        q = T_odom_imu[:3, :3] @ p + T_odom_imu[:3, 3]
        found = find_slowly(slow_map, q, gate, fallback=True)
        if found is None:
            continue
        n, point, variance, source, _ = found
        fallbacks += source == 255
        pose = pose_row(p, n, T_odom_imu)
        motion = [] if before_end is None else motion_row(before_end[i], pose)
        mounting = []
        if T_first is not None:
            mounting = mounting_row(n, q, T_odom_imu, T_imu_lidar, T_first=T_first, source=source)
        terms.append((np.concatenate([pose, motion, mounting])[None], np.array([n @ (q - point)]), sigma**2 + variance))
    return *sums_slowly(terms, 6 + 6 * (before_end is not None) + 6 * (T_first is not None), kernel), fallbacks


def feigned_slowly(slow_map, points, T_odom_imu, *, gate, kernel, sigma, before_end=None):
    """What tilts of the normals add to the information in expectation, by turning each normal about two axes.

    Also the sum of squares of what each match adds.
    """
    size = 6 if before_end is None else 12
    F, square = np.zeros((size, size)), 0.0
    for i, p in enumerate(points.astype(np.float64)):
        q = T_odom_imu[:3, :3] @ p + T_odom_imu[:3, 3]
        found = find_slowly(slow_map, q, gate, fallback=True)
        if found is None:
            continue
        n, point, variance, _, tilt = found
        r = n @ (q - point)
        w = (kernel**2 / (kernel**2 + r * r)) ** 2 / (sigma**2 + variance)
        _, _, axes = np.linalg.svd(n[None])
        for t in axes[1:]:
            row = pose_row(p, t, T_odom_imu)
            row = row if before_end is None else np.concatenate([row, motion_row(before_end[i], row)])
            F += w * tilt * np.outer(row, row)
        square += (w * tilt) ** 2
    return F, square


def match_points_slowly(slow_map, points, T_odom_imu, *, gate, kernel, sigma, before_end=None):
    terms = []
    for i, p in enumerate(points.astype(np.float64)):
        q = T_odom_imu[:3, :3] @ p + T_odom_imu[:3, 3]
        near = slow_map.nearest(q, gate)
        if not near:
            continue
        J = np.stack([pose_row(p, n, T_odom_imu) for n in np.eye(3)])
        if before_end is not None:
            J = np.hstack([J, [motion_row(before_end[i], row) for row in J]])
        terms.append((J, q - near[0], sigma**2))
    return *sums_slowly(terms, 6 if before_end is None else 12, kernel), 0
