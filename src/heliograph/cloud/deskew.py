"""Motion compensation: every point through the pose at its own time, ``p_ref = T_ref^-1 T(tau) p``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, as_pose, require_finite
from heliograph.errors import DataError

__all__ = ["deskew"]


def deskew(
    points: NDArray[np.float32],
    offsets_ns: NDArray[np.int32],
    *,
    stamp_ns: int,
    path_stamps_ns: NDArray[np.int64],
    R_odom_body: NDArray[np.float64],
    p_odom: NDArray[np.float64],
    T_body_lidar: NDArray[np.float64],
    reference: int = -1,
    threads: int = 1,
) -> NDArray[np.float32]:
    """Express all points of a sweep in the body frame at one instant.

    Parameters
    ----------
    points : (N, 3) float32
        In the lidar frame, each at its own time [m]. A point that is not finite stays so.
    offsets_ns : (N,) int32
        Time of each point since ``stamp_ns`` [ns].
    stamp_ns : int
        The sweep's start [ns].
    path_stamps_ns : (K,) int64
        Increasing stamps of the body's path [ns]; outside them the nearest pose is held.
    R_odom_body, p_odom : (K, 3, 3), (K, 3) float64
        The path. Between two stamps rotation follows the geodesic, position the straight line.
    T_body_lidar : (4, 4) float64
        Mounting.
    reference : int
        Index into the path of the instant to express the points at: -1 its end, 0 its start.
    threads : int
        Threads of the native loop; the result does not depend on it.

    Returns
    -------
    (N, 3) float32
        In the body frame at the reference instant [m].

    Raises
    ------
    DataError
        An array of another dtype or shape, an empty path or one that is not finite, lengths that differ, or a
        reference outside the path.
    """
    points = as_points("points", points)
    offsets_ns = as_array("offsets_ns", offsets_ns, np.int32, (None,))
    path_stamps_ns = as_array("path_stamps_ns", path_stamps_ns, np.int64, (None,))
    R_odom_body = require_finite("R_odom_body", as_array("R_odom_body", R_odom_body, np.float64, (None, 3, 3)))
    p_odom = require_finite("p_odom", as_array("p_odom", p_odom, np.float64, (None, 3)))
    T_body_lidar = as_pose("T_body_lidar", T_body_lidar)
    if len(path_stamps_ns) == 0 or len(R_odom_body) != len(path_stamps_ns) or len(p_odom) != len(path_stamps_ns):
        raise DataError(
            f"{len(path_stamps_ns)} stamps, {len(R_odom_body)} rotations, {len(p_odom)} positions; need one each"
        )
    if len(points) != len(offsets_ns):
        raise DataError(f"{len(points)} points but {len(offsets_ns)} time offsets")
    if not -len(p_odom) <= reference < len(p_odom):
        raise DataError(f"reference {reference} is no index into a path of {len(p_odom)} poses")
    R_ref = R_odom_body[reference]
    # Relative to the reference in double, so that single precision is enough inside the sweep.
    R = np.ascontiguousarray(R_ref.T @ R_odom_body)
    p = np.ascontiguousarray((p_odom - p_odom[reference]) @ R_ref)
    times = np.ascontiguousarray(path_stamps_ns - stamp_ns, dtype=np.int64)
    return np.asarray(_core.deskew(points, offsets_ns, times, R, p, T_body_lidar, threads))
