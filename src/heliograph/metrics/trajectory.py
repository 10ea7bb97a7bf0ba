"""How far an estimated trajectory is from a reference.

References
----------
.. [1] J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012 (absolute and relative error).
.. [2] S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
.. [3] Z. Zhang, D. Scaramuzza, "A tutorial on quantitative trajectory evaluation", IROS 2018 (alignment about the
   vertical).
.. [4] G. Wahba, "A least squares estimate of satellite attitude", SIAM Review 1965.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, as_array, freeze, require_finite
from heliograph.data import Trajectory
from heliograph.errors import ConfigError, DataError, closest
from heliograph.lie import interpolate_se3, se3, so3

__all__ = [
    "ALIGNMENTS",
    "AbsoluteError",
    "Association",
    "RelativeError",
    "absolute_trajectory_error",
    "align",
    "align_poses",
    "associate",
    "best_time_offset",
    "change_body",
    "path_length",
    "relative_pose_error",
    "start_end_gap",
]

ALIGNMENTS = ("se3", "yaw", "origin", "none")
# Positions that spread less than this across their main direction do not determine a rotation.
_EXACT = 1e-9  # errors below count as this [m], [rad]
_MIN_SPREAD = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Association:
    """Poses of an estimate and a reference at the same instants.

    Parameters
    ----------
    stamps_ns : (N,) int64
        The reference's stamps, or the estimate's where the reference is much denser [ns].
    T_estimate : (N, 4, 4) float64
        The estimate's poses there, in its own fixed frame.
    T_reference : (N, 4, 4) float64
        The reference's poses.
    distance : (N,) float64
        Length of the whole reference's path up to each pose, also over poses that found no partner [m].
    """

    stamps_ns: NDArray[np.int64]
    T_estimate: Array
    T_reference: Array
    distance: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsoluteError:
    """Distance between the aligned estimate and the reference, over all poses.

    Parameters
    ----------
    n : int
        Poses compared.
    rmse, mean, median, max : float
        Statistics of the position error [m].
    rotation_rmse_deg : float
        Root mean square of the angle between the orientations [deg].
    T_reference_estimate : (4, 4) float64
        The alignment: maps the estimate's fixed frame into the reference's.
    errors : (n,) float64
        Position error of each pose [m].
    """

    n: int
    rmse: float
    mean: float
    median: float
    max: float
    rotation_rmse_deg: float
    T_reference_estimate: Array
    errors: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeError:
    """Error of the motion over a fixed length of path: the drift. NaN where the path is shorter than that.

    Parameters
    ----------
    delta : float
        Path length between the poses of a pair, at least [m].
    n : int
        Pairs.
    translation_rmse, translation_median, translation_max : float
        [m].
    translation_rmse_percent : float
        Root mean square in percent of each pair's own path length.
    rotation_rmse_deg, rotation_median_deg, rotation_max_deg : float
        [deg].
    """

    delta: float
    n: int
    translation_rmse: float
    translation_median: float
    translation_max: float
    translation_rmse_percent: float
    rotation_rmse_deg: float
    rotation_median_deg: float
    rotation_max_deg: float


def associate(
    estimate: Trajectory, reference: Trajectory, *, time_offset: float = 0.0, max_gap_s: float = 0.5
) -> Association:
    """Return both trajectories at common stamps, the denser one interpolated on SE(3).

    These are the reference's stamps, unless the reference is more than twice as dense: a 10 Hz estimate says nothing
    about the sway between its rows, so a 200 Hz reference is then read at the estimate's stamps instead.

    Parameters
    ----------
    estimate, reference : Trajectory
        Trajectories of the same body.
    time_offset : float
        Added to the estimate's stamps first [s].
    max_gap_s : float
        A stamp between two poses of the interpolated trajectory farther apart than this is left out, as is one outside
        its time span [s]. One that hits a stamp is always used.

    Raises
    ------
    DataError
        Nothing overlaps.
    """
    shift_ns, max_gap_ns = round(time_offset * 1e9), round(max_gap_s * 1e9)
    stamps = estimate.stamps_ns + shift_ns
    by_estimate = _period(reference.stamps_ns) * 2.0 < _period(stamps)
    query, dense = (stamps, reference.stamps_ns) if by_estimate else (reference.stamps_ns, stamps)
    usable = _find_covered(dense, query, max_gap_ns) if len(dense) else np.zeros(len(query), dtype=bool)
    if not usable.any():
        raise DataError(_no_overlap(estimate, reference, max_gap_s))
    at = query[usable]
    travelled = _path_lengths(reference.T_frame_body)
    return Association(
        stamps_ns=at,
        T_estimate=estimate.T_frame_body[usable] if by_estimate else interpolate_se3(stamps, estimate.T_frame_body, at),
        T_reference=interpolate_se3(reference.stamps_ns, reference.T_frame_body, at)
        if by_estimate
        else reference.T_frame_body[usable],
        distance=np.interp(at, reference.stamps_ns, travelled),
    )


def _period(stamps_ns: NDArray[np.int64]) -> float:
    """Return the median distance between stamps [ns]."""
    return float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else float("inf")


def align(T_estimate: Array, T_reference: Array, mode: str = "se3") -> Array:
    """Return the transform that brings an estimate's fixed frame onto the reference's.

    Parameters
    ----------
    T_estimate, T_reference : (N, 4, 4) float64
        Poses at the same instants.
    mode : str
        ``"se3"``: least squares over the positions, without scale [2]_. ``"yaw"``: the same with a rotation about the
        vertical only [3]_, for estimates whose gravity direction must count. ``"origin"``: the first poses coincide.
        ``"none"``: identity.

    Returns
    -------
    (4, 4) float64
        ``T_reference_estimate``.

    Raises
    ------
    DataError
        Arrays of another kind, or the positions do not determine the rotation: a body at rest, or for ``"se3"`` an
        exactly straight path.
    ConfigError
        Unknown mode.
    """
    if mode not in ALIGNMENTS:
        raise ConfigError(f"alignment '{mode}' is not one of {', '.join(ALIGNMENTS)}{closest(mode, ALIGNMENTS)}")
    T_estimate, T_reference = _pose_pairs(T_estimate, T_reference)
    if mode == "none":
        return np.eye(4)
    if mode == "origin":
        return se3.compose(T_reference[0], se3.inverse(T_estimate[0]))
    p_estimate, p_reference = T_estimate[:, :3, 3], T_reference[:, :3, 3]
    center_estimate, center_reference = p_estimate.mean(axis=0), p_reference.mean(axis=0)
    cross = (p_reference - center_reference).T @ (p_estimate - center_estimate) / len(p_estimate)
    R = _rotation_yaw(cross) if mode == "yaw" else _rotation_full(cross)
    return se3.from_rotation_translation(R, center_reference - R @ center_estimate)


def align_poses(T_estimate: Array, T_reference: Array) -> Array:
    """Return the transform that brings an estimate's fixed frame onto the reference's, by orientations and positions.

    Positions alone leave the rotation open where a body rests or goes straight ahead; a map is then turned away.
    Wahba's problem [4]_ with vectors of both kinds: positions count by their error, orientations by theirs, as the mean
    of the orientations' differences shows them.

    Parameters
    ----------
    T_estimate, T_reference : (N, 4, 4) float64
        Poses at the same instants.

    Returns
    -------
    (4, 4) float64
        ``T_reference_estimate``.

    Raises
    ------
    DataError
        Arrays of another kind, or no poses.
    """
    T_estimate, T_reference = _pose_pairs(T_estimate, T_reference)
    p_estimate, p_reference = T_estimate[:, :3, 3], T_reference[:, :3, 3]
    center_estimate, center_reference = p_estimate.mean(axis=0), p_reference.mean(axis=0)
    around_estimate, around_reference = p_estimate - center_estimate, p_reference - center_reference
    differences = (T_reference[:, :3, :3] @ T_estimate[:, :3, :3].swapaxes(1, 2)).mean(axis=0)
    R = so3.project(differences)
    aligned = R @ T_estimate[:, :3, :3]
    turned = np.radians(_rms(_angle_deg(so3.inverse(T_reference[:, :3, :3]) @ aligned)))
    moved = _rms(np.linalg.norm(around_estimate @ R.T - around_reference, axis=1))
    cross = around_reference.T @ around_estimate / len(p_estimate)
    R = so3.project(cross / max(moved, _EXACT) ** 2 + 0.5 * differences / max(turned, _EXACT) ** 2)
    return se3.from_rotation_translation(R, center_reference - R @ center_estimate)


def _pose_pairs(T_estimate: Array, T_reference: Array) -> tuple[Array, Array]:
    """Return both as arrays of as many poses, at least one."""
    T_estimate = require_finite("T_estimate", as_array("T_estimate", T_estimate, np.float64, (None, 4, 4)))
    shape = (len(T_estimate), 4, 4)
    T_reference = require_finite("T_reference", as_array("T_reference", T_reference, np.float64, shape))
    if len(T_estimate) == 0:
        raise DataError("T_estimate holds no poses; at least one pair is needed")
    return T_estimate, T_reference


def absolute_trajectory_error(pair: Association, *, mode: str = "se3") -> AbsoluteError:
    """Return the absolute trajectory error after alignment ([1]_, section V-B; `align` says what the modes are)."""
    T_reference_estimate = align(pair.T_estimate, pair.T_reference, mode)
    aligned = T_reference_estimate @ pair.T_estimate
    errors = np.linalg.norm(aligned[:, :3, 3] - pair.T_reference[:, :3, 3], axis=1)
    angles = _angle_deg(so3.inverse(pair.T_reference[:, :3, :3]) @ aligned[:, :3, :3])
    return AbsoluteError(
        n=len(pair),
        rmse=_rms(errors),
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        max=float(errors.max()),
        rotation_rmse_deg=_rms(angles),
        T_reference_estimate=T_reference_estimate,
        errors=errors,
    )


def relative_pose_error(pair: Association, *, delta: float = 10.0) -> RelativeError:
    """Return the error of the motion between every pose and the first later one at least `delta` further on.

    Distances are along the reference's path. The error of a pair is ``inv(inv(Q_i) Q_j) inv(P_i) P_j`` with the
    reference Q and the estimate P ([1]_, section V-A); no alignment enters.

    Raises
    ------
    DataError
        `delta` is not positive.
    """
    first, second = _pairs(pair.distance, delta)
    translation, rotation = _relative(pair, first, second)
    length = pair.distance[second] - pair.distance[first]
    return RelativeError(
        delta=delta,
        n=len(first),
        translation_rmse=_rms(translation),
        translation_median=_or_nan(np.median, translation),
        translation_max=_or_nan(np.max, translation),
        translation_rmse_percent=_rms(100.0 * translation / length),
        rotation_rmse_deg=_rms(rotation),
        rotation_median_deg=_or_nan(np.median, rotation),
        rotation_max_deg=_or_nan(np.max, rotation),
    )


def best_time_offset(
    estimate: Trajectory, reference: Trajectory, *, limit_s: float = 0.06, delta: float = 10.0, max_gap_s: float = 0.5
) -> float:
    """Return the constant shift of the estimate's stamps that minimises the relative rotation error [s].

    Rotation alone is used: an error in time along a straight road looks like one of position. All shifts are judged on
    the same pairs, those that the estimate covers at every shift within the limit.

    Parameters
    ----------
    estimate, reference : Trajectory
        Trajectories of the same body.
    limit_s : float
        Largest shift considered, either way [s].
    delta : float
        Path length of a pair [m].
    max_gap_s : float
        As in `associate`.

    Returns
    -------
    float
        To be added to the estimate's stamps, to 0.01 ms [s].

    Raises
    ------
    DataError
        No pair of poses `delta` apart is covered at every shift.
    """
    limit_ns, gap_ns = round(limit_s * 1e9), round(max_gap_s * 1e9)
    shifts = np.linspace(-limit_ns, limit_ns, 2 * max(4, int(np.ceil(limit_s / 0.005))) + 1)
    usable = np.ones(len(reference), dtype=bool)
    for shift in (-limit_ns, 0, limit_ns):
        usable &= _find_covered(estimate.stamps_ns, reference.stamps_ns - shift, gap_ns)
    if not usable.any():
        raise DataError(_no_overlap(estimate, reference, max_gap_s))
    distance = _path_lengths(reference.T_frame_body)[usable]
    first, second = _pairs(distance, delta)
    if len(first) == 0:
        raise DataError(
            f"the overlap is {distance[-1] - distance[0]:.1f} m long; a time offset needs pairs {delta:g} m apart: "
            "give a smaller delta, or the offset as a number"
        )

    def cost(shift: float) -> float:
        query = reference.stamps_ns[usable] - round(shift)
        T_estimate = interpolate_se3(estimate.stamps_ns, estimate.T_frame_body, query)
        pair = Association(
            stamps_ns=query, T_estimate=T_estimate, T_reference=reference.T_frame_body[usable], distance=distance
        )
        return _rms(_relative(pair, first, second)[1])

    best = int(np.argmin([cost(shift) for shift in shifts]))
    low, high = shifts[max(best - 1, 0)], shifts[min(best + 1, len(shifts) - 1)]
    return _golden_section(cost, float(low), float(high), tolerance=1e4) * 1e-9


def change_body(trajectory: Trajectory, T_body_new: Array, *, body: str) -> Trajectory:
    """Return the path of another frame fixed to the same body: ``T_frame_new = T_frame_body @ T_body_new``."""
    return Trajectory(
        stamps_ns=trajectory.stamps_ns,
        T_frame_body=trajectory.T_frame_body @ np.asarray(T_body_new, dtype=np.float64),
        frame=trajectory.frame,
        body=body,
    )


def path_length(trajectory: Trajectory) -> float:
    """Return the length of the path [m]."""
    return float(_path_lengths(trajectory.T_frame_body)[-1]) if len(trajectory) else 0.0


def start_end_gap(trajectory: Trajectory) -> float:
    """Return the straight distance between the first and the last position [m]; 0 for fewer than two poses."""
    if len(trajectory) < 2:
        return 0.0
    return float(np.linalg.norm(trajectory.T_frame_body[-1, :3, 3] - trajectory.T_frame_body[0, :3, 3]))


def _find_covered(stamps_ns: NDArray[np.int64], query_ns: NDArray[np.int64], max_gap_ns: int) -> NDArray[np.bool_]:
    """Return which queries lie between two stamps that are near enough to each other, or on one."""
    before = np.searchsorted(stamps_ns, query_ns, side="right") - 1
    after = np.minimum(np.searchsorted(stamps_ns, query_ns, side="left"), len(stamps_ns) - 1)
    inside = (query_ns >= stamps_ns[0]) & (query_ns <= stamps_ns[-1])
    before = np.maximum(before, 0)
    return np.asarray(inside & (stamps_ns[after] - stamps_ns[before] <= max_gap_ns), dtype=bool)


def _no_overlap(estimate: Trajectory, reference: Trajectory, max_gap_s: float) -> str:
    spans = [
        f"{t.stamps_ns[0] * 1e-9:.3f} to {t.stamps_ns[-1] * 1e-9:.3f} s" if len(t) else "nothing"
        for t in (estimate, reference)
    ]
    return (
        f"no pose of the reference (it holds {spans[1]}) lies between two estimated poses at most {max_gap_s:g} s "
        f"apart (the estimate holds {spans[0]}); check that both use the same clock"
    )


def _path_lengths(poses: Array) -> Array:
    """Return the path length up to each pose."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _rotation_full(cross: Array) -> Array:
    if not np.isfinite(cross).all():
        raise DataError("the positions are too large to be aligned; check the units of both trajectories")
    u, spread, vt = np.linalg.svd(cross)
    if spread[1] < _MIN_SPREAD**2:
        raise DataError(
            "the positions lie on a straight line or do not move, which leaves the rotation of an se3 alignment open; "
            "align by yaw or by the origin"
        )
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return np.asarray(u @ np.diag([1.0, 1.0, sign]) @ vt, dtype=np.float64)


def _rotation_yaw(cross: Array) -> Array:
    sine, cosine = cross[1, 0] - cross[0, 1], cross[0, 0] + cross[1, 1]
    if np.hypot(sine, cosine) < _MIN_SPREAD**2:
        raise DataError("the positions do not move over the ground, which leaves the yaw open; align by the origin")
    return so3.exp([0.0, 0.0, np.arctan2(sine, cosine)])


def _pairs(distance: Array, delta: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return index pairs: every pose with the first later one at least `delta` further along."""
    if not delta > 0.0:
        raise DataError(f"a relative error over {delta:g} m means nothing; give a positive delta")
    second = np.searchsorted(distance, distance + delta, side="left")
    first = np.flatnonzero(second < len(distance))
    return first, second[first]


def _relative(pair: Association, first: NDArray[np.intp], second: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the translation [m] and rotation [deg] error of each pair."""
    motion_reference = se3.inverse(pair.T_reference[first]) @ pair.T_reference[second]
    motion_estimate = se3.inverse(pair.T_estimate[first]) @ pair.T_estimate[second]
    error = se3.inverse(motion_reference) @ motion_estimate
    translation: Array = np.linalg.norm(error[:, :3, 3], axis=1)
    return translation, _angle_deg(error[:, :3, :3])


def _angle_deg(R: Array) -> Array:
    return np.asarray(np.rad2deg(np.linalg.norm(so3.log(R), axis=-1)), dtype=np.float64)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _or_nan(statistic: Callable[[Array], np.floating], values: Array) -> float:
    return float(statistic(values)) if len(values) else float("nan")


def _golden_section(cost: Callable[[float], float], low: float, high: float, *, tolerance: float) -> float:
    """Return the minimum of a function with one valley in the interval."""
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    cost_left, cost_right = cost(left), cost(right)
    while high - low > tolerance:
        if cost_left <= cost_right:
            high, right, cost_right = right, left, cost_left
            left = high - ratio * (high - low)
            cost_left = cost(left)
        else:
            low, left, cost_left = left, right, cost_right
            right = low + ratio * (high - low)
            cost_right = cost(right)
    return float(0.5 * (low + high))
