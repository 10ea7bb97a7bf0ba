"""Normal equations of point-to-plane residuals, ``r = n . (R p + t - c)``, under a robust kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.errors import ConfigError
from heliograph.maps import LocalMap, PlaneMatches, VoxelMap

__all__ = ["MatchSettings", "NormalEquations", "gradient_scatter", "linearize"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """How matches are made and weighed.

    Parameters
    ----------
    gate : float
        Largest residual of a match [m].
    kernel : float
        Scale of the Geman-McClure kernel [m]; 0 for least squares.
    sigma : float
        Noise of one measurement across its plane [m].
    fallback_stride : int
        One of so many points without a plane asks for its neighbours; 0: none.
    residual : str
        ``"plane"``, or ``"point"``: the distance to the nearest stored point, for comparison only. Its information is
        the identity whatever the geometry, so it cannot see a degenerate one.
    mounting : bool
        Also by the mounting's rotation and lever arm.
    both : bool
        Whether a mounting leaves the columns of the motion in place, instead of taking theirs.
    threads : int
        Of the native loop; the result does not depend on it.
    """

    gate: float
    kernel: float
    sigma: float
    fallback_stride: int = 1
    residual: str = "plane"
    mounting: bool = False
    both: bool = False
    threads: int = 1


_COLUMNS_POSE = np.arange(6)
_COLUMNS_MOTION = np.arange(12)
_COLUMNS_MOUNTING = np.concatenate([np.arange(6), np.arange(17, 23)])
_COLUMNS_BOTH = np.concatenate([np.arange(12), np.arange(17, 23)])


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalEquations:
    """Sums over the matches.

    Parameters
    ----------
    columns : (C,) int
        Which errors of the filter's state the columns are: rotation (body) and position (odom), then velocity (odom)
        and gyro bias, or mounting rotation (lidar) and lever arm (imu), or all of these.
    information : (C, C) float64
        Sum of ``w / s^2 J^T J``.
    gradient : (C,) float64
        Sum of ``w / s^2 J^T r``.
    weight : float
        Sum of ``w / s^2`` [1/m^2].
    robust_weight, square : float
        Sums of ``w`` and of ``w r^2`` [m^2]; the root of their quotient is the robust RMS.
    cost : float
        Sum of ``rho(r) / s^2``.
    matches, fallback_matches, queries : int
        Points with a plane, those of them with one through neighbours, and all that asked.
    """

    information: NDArray[np.float64]
    gradient: NDArray[np.float64]
    columns: NDArray[np.intp]
    weight: float
    robust_weight: float
    square: float
    cost: float
    matches: int
    fallback_matches: int
    queries: int

    @property
    def rms(self) -> float:
        """Robust root mean square of the residuals [m]; NaN without matches."""
        return float(np.sqrt(self.square / self.robust_weight)) if self.robust_weight > 0.0 else float("nan")


def linearize(
    local_map: LocalMap,
    points_imu: NDArray[np.float32],
    T_odom_imu: NDArray[np.float64],
    T_imu_lidar: NDArray[np.float64],
    settings: MatchSettings,
    *,
    before_end: NDArray[np.float32] | None = None,
) -> NormalEquations:
    """Match points to the map at a pose and return the normal equations of the residuals.

    Jacobians are by right perturbations: ``J_rotation = (p x R^T n)``, ``J_position = n``. For the motion, with the
    point measured ``dt`` before the sweep's end, ``J_velocity = -dt n`` and ``J_gyro_bias = dt J_rotation``: de-skewing
    has carried it forward by both. For the mounting, with ``p_l`` the point in the lidar frame and ``m = R^T n``,
    ``(p_l x R_il^T m)`` and ``m``, less the same at the map's very first pose: an error of the mounting moves the whole
    map by what it did there, and only the difference shows. These neglect the motion within the sweep. Each match has
    the variance ``sigma^2`` plus its plane's own at the query.

    Parameters
    ----------
    local_map : LocalMap
        A `VoxelMap` is searched natively; any other is asked for planes and summed with NumPy.
    points_imu : (N, 3) float32
        De-skewed, imu frame at the sweep's end [m].
    T_odom_imu, T_imu_lidar : (4, 4) float64
        Pose to linearise at, and mounting.
    settings : MatchSettings
    before_end : (N,) float32, optional
        Time of each point before the sweep's end [s]; needed for the columns of the motion.

    Raises
    ------
    ConfigError
        An unknown residual, or point residuals on a map that has none.
    """
    if settings.residual not in ("plane", "point"):
        raise ConfigError(f"residual '{settings.residual}' is not one of 'plane', 'point'")
    motion = before_end is not None and (settings.both or not settings.mounting)
    if not isinstance(local_map, VoxelMap):
        if settings.mounting:
            raise ConfigError(
                "the mounting can be estimated with the voxel map only; give the transform with --extrinsic"
            )
        return _linearize_any(local_map, points_imu, T_odom_imu, settings, before_end if motion else None)
    scan = (
        local_map.native,
        points_imu,
        before_end if before_end is not None and motion else np.zeros(0, np.float32),
        np.ascontiguousarray(T_odom_imu),
        np.ascontiguousarray(T_imu_lidar),
        settings.gate,
        settings.kernel,
        settings.sigma,
    )
    errors = _errors(mounting=settings.mounting, motion=motion)
    if settings.residual == "plane":
        stride, reach = settings.fallback_stride, local_map.config.fallback_range
        sums = _core.match_planes(*scan, stride, reach, len(errors), settings.threads)
    else:
        sums = _core.match_points(*scan, len(errors), settings.threads)
    return _from_sums(sums, errors, len(points_imu))


def _errors(*, mounting: bool, motion: bool) -> NDArray[np.intp]:
    if mounting:
        return _COLUMNS_BOTH if motion else _COLUMNS_MOUNTING
    return _COLUMNS_MOTION if motion else _COLUMNS_POSE


def _from_sums(sums: tuple[Any, ...], columns: NDArray[np.intp], queries: int) -> NormalEquations:
    """Name what the native kernels return."""
    return NormalEquations(
        information=sums[0],
        gradient=sums[1],
        columns=columns,
        weight=sums[2],
        robust_weight=sums[3],
        square=sums[4],
        cost=sums[5],
        matches=sums[6],
        fallback_matches=sums[7],
        queries=queries,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Matches:
    """Matches one by one: Jacobian (M, C), residual (M,), robust weight (M,), inverse variance (M,), source (M,)."""

    J: NDArray[np.float64]
    r: NDArray[np.float64]
    w: NDArray[np.float64]
    inv_var: NDArray[np.float64]
    source: NDArray[np.uint8]


def _matched(
    found: PlaneMatches,
    points: NDArray[np.float64],
    T: NDArray[np.float64],
    settings: MatchSettings,
    before_end: NDArray[np.float32] | None = None,
) -> _Matches:
    some = found.source > 0
    p, n = points[some], found.normal[some].astype(np.float64)
    r = np.einsum("ij,ij->i", n, p @ T[:3, :3].T + T[:3, 3] - found.point[some])
    columns = [np.cross(p, n @ T[:3, :3]), n]
    if before_end is not None:
        dt = before_end[some, None].astype(np.float64)
        columns += [-dt * n, dt * columns[0]]
    c2 = settings.kernel**2
    return _Matches(
        J=np.hstack(columns),
        r=r,
        w=(c2 / (c2 + r * r)) ** 2 if c2 > 0.0 else np.ones_like(r),
        inv_var=np.asarray(1.0 / (settings.sigma**2 + found.variance[some]), dtype=np.float64),
        source=found.source[some],
    )


def gradient_scatter(
    local_map: VoxelMap, points: NDArray[np.float32], T_odom_body: NDArray[np.float64], settings: MatchSettings
) -> NDArray[np.float64]:
    """Return the sum of ``(w / s^2 r)^2 J^T J`` over the matches, (6, 6), rows as in `linearize`.

    With the information A it gives the covariance ``A^-1 B A^-1`` of the pose for noise that differs from point to
    point, as that of a range seen under a flat angle does (H. White, 1980). Points without a plane are left out.
    """
    p = points.astype(np.float64)
    at = p @ T_odom_body[:3, :3].T + T_odom_body[:3, 3]
    found = _matched(local_map.planes_at(at, gate=settings.gate, neighbours=False), p, T_odom_body, settings)
    rows = found.J * (found.w * found.inv_var * found.r)[:, None]
    return np.asarray(rows.T @ rows)


def _linearize_any(
    local_map: LocalMap,
    points_imu: NDArray[np.float32],
    T_odom_imu: NDArray[np.float64],
    settings: MatchSettings,
    before_end: NDArray[np.float32] | None,
) -> NormalEquations:
    """Do the same for a user's own map, in NumPy."""
    if settings.residual == "point":
        raise ConfigError("point-to-point residuals exist for the voxel map only; use residual 'plane'")
    p = points_imu.astype(np.float64)
    planes = local_map.planes_at(p @ T_odom_imu[:3, :3].T + T_odom_imu[:3, 3], gate=settings.gate)
    found = _matched(planes, p, T_odom_imu, settings, before_end)
    r, w, c2 = found.r, found.w, settings.kernel**2
    rho = 0.5 * r * r * (c2 / (c2 + r * r) if c2 > 0.0 else 1.0)
    weighted = found.J * (w * found.inv_var)[:, None]
    return NormalEquations(
        information=weighted.T @ found.J,
        gradient=weighted.T @ r,
        columns=_errors(mounting=False, motion=before_end is not None),
        weight=float((w * found.inv_var).sum()),
        robust_weight=float(w.sum()),
        square=float((w * r * r).sum()),
        cost=float((rho * found.inv_var).sum()),
        matches=len(r),
        fallback_matches=int((found.source == 255).sum()),
        queries=len(points_imu),
    )
