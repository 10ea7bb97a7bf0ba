"""Poses between the stamps of a trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import as_batch, as_stamps
from heliograph.errors import DataError
from heliograph.lie import se3

__all__ = ["interpolate_se3"]


def interpolate_se3(
    stamps_ns: ArrayLike, T_frame_body: ArrayLike, query_ns: ArrayLike, *, extrapolate: bool = False
) -> NDArray[np.float64]:
    """Return the poses at the queried times.

    Between two stamps the body moves with a constant twist: the geodesic of SE(3), not of SO(3) x R^3. The path is then
    the same whichever point of the body is followed, so interpolation commutes with a change of body or of fixed frame,
    and a turning vehicle keeps to its arc instead of cutting the corner.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Non-decreasing times, N >= 1 [ns].
    T_frame_body : (N, 4, 4) float64
        Poses at those times. Of poses with equal stamps the last holds from there on.
    query_ns : (...) int64
        Times asked for, in any order [ns].
    extrapolate : bool
        Continue the first and the last segment's twist outside the stamps instead of refusing.

    Returns
    -------
    (..., 4, 4) float64
        Exactly the given pose where a query hits its stamp.

    Raises
    ------
    DataError
        Arrays of another kind, no poses, lengths that differ, or (without `extrapolate`) a query outside the stamps.
    """
    stamps, query = as_stamps("stamps_ns", stamps_ns), as_stamps("query_ns", query_ns)
    poses = as_batch("T_frame_body", T_frame_body, (4, 4))
    if stamps.ndim != 1:
        raise DataError(f"stamps_ns has shape {stamps.shape}, expected (N,)")
    if len(stamps) == 0 or poses.shape != (len(stamps), 4, 4):
        raise DataError(
            f"{len(stamps)} stamps with poses of shape {poses.shape}; give one (4, 4) pose a stamp, and at least one"
        )
    outside = (query < stamps[0]) | (query > stamps[-1])
    if not extrapolate and np.any(outside):
        raise DataError(
            f"{np.count_nonzero(outside)} of {query.size} queries lie outside the trajectory ({stamps[0]} to "
            f"{stamps[-1]} ns); trim them or ask for extrapolation"
        )
    before = np.clip(np.searchsorted(stamps, query, side="right") - 1, 0, max(len(stamps) - 2, 0))
    after = np.minimum(before + 1, len(stamps) - 1)
    span = (stamps[after] - stamps[before]).astype(np.float64)
    # A segment of no length has no twist; hold its pose.
    fraction = np.where(span > 0.0, (query - stamps[before]) / np.where(span > 0.0, span, 1.0), 0.0)
    twist = se3.local(poses[before], poses[after])
    moved = poses[before] @ se3.exp(fraction[..., None] * twist)
    return np.where((query == stamps[after])[..., None, None], poses[after], moved)
