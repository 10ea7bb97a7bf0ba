"""Slow, obvious twins of the native cloud kernels: one point at a time in double precision."""

import numpy as np
from scipy.spatial.transform import Rotation


def deskew_slowly(points, offsets_ns, *, stamp_ns, path_stamps_ns, R_odom_body, p_odom, T_body_lidar, reference=-1):
    """Return every point through the pose at its own time, in the body frame at the reference pose, (N, 3) float64."""
    R_ref, p_ref = R_odom_body[reference], p_odom[reference]
    out = np.zeros((len(points), 3))
    for i, (point, offset) in enumerate(zip(points.astype(np.float64), offsets_ns, strict=True)):
        R, p = pose_at(int(stamp_ns) + int(offset), path_stamps_ns, R_odom_body, p_odom)
        p_body = T_body_lidar[:3, :3] @ point + T_body_lidar[:3, 3]
        out[i] = R_ref.T @ (R @ p_body + p - p_ref)
    return out


def pose_at(t, stamps_ns, R, p):
    """Geodesic rotation and straight line between the neighbours in time; held outside."""
    if t <= stamps_ns[0]:
        return R[0], p[0]
    for k in range(len(stamps_ns) - 1):
        if stamps_ns[k] <= t < stamps_ns[k + 1]:
            s = (t - int(stamps_ns[k])) / (int(stamps_ns[k + 1]) - int(stamps_ns[k]))
            turn = Rotation.from_matrix(R[k].T @ R[k + 1]).as_rotvec()
            return R[k] @ Rotation.from_rotvec(s * turn).as_matrix(), (1.0 - s) * p[k] + s * p[k + 1]
    return R[-1], p[-1]


def rank(point, dropped=0):
    """Return the pseudo-random rank of a float32 point: multiplied and folded bits, in Python's own integers."""
    wide = 2**64 - 1
    x, y, z = (int(bits) >> dropped for bits in np.asarray(point, np.float32).view(np.uint32))
    h = (x * 0x9E3779B97F4A7C15 & wide) ^ (y * 0xC2B2AE3D27D4EB4F & wide) ^ (z * 0x165667B19E3779F9 & wide)
    return ((h ^ h >> 32) * 0xD6E8FEB86659FD93 & wide) >> 32


def downsample_slowly(points, leaf):
    """Return the index of the finite point of lowest rank of each cube, by cube."""
    cubes = {}
    inverse = np.float32(1.0) / np.float32(leaf)
    for i, point in enumerate(points):
        if np.isfinite(point).all():
            cubes.setdefault(tuple(int(np.floor(x * inverse)) for x in point), []).append(i)
    best = [min(cubes[cube], key=lambda i: rank(points[i])) for cube in sorted(cubes)]
    return np.array(best, dtype=np.int32)


def range_gate_slowly(points, low, high):
    """Return the indices of the finite points whose distance lies in [low, high]."""
    kept = [
        i for i, p in enumerate(points.astype(np.float64)) if np.isfinite(p).all() and low <= np.linalg.norm(p) <= high
    ]
    return np.array(kept, dtype=np.int32)
