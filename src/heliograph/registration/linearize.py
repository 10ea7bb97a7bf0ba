"""Normal equations of point-to-plane residuals, ``r = n . (R p + t - c)``, under a robust kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.errors import ConfigError
from heliograph.maps import LocalMap, VoxelMap

__all__ = ["MatchSettings", "NormalEquations", "linearize"]


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
        Also by the mounting's rotation and lever arm: 12 columns instead of 6.
    threads : int
        Of the native loop; the result does not depend on it.
    """

    gate: float
    kernel: float
    sigma: float
    fallback_stride: int = 1
    residual: str = "plane"
    mounting: bool = False
    threads: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalEquations:
    """Sums over the matches, with columns rotation (body) 3, position (odom) 3[, mounting rotation (lidar) 3, lever arm (imu) 3].

    Parameters
    ----------
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
) -> NormalEquations:
    """Match points to the map at a pose and return the normal equations of the residuals.

    Jacobians are by right perturbations: ``J_rotation = (p x R^T n)``, ``J_position = n``; for the mounting, with ``p_l``
    the point in the lidar frame and ``m = R^T n``, ``(p_l x R_il^T m)`` and ``m``. The last two neglect the motion
    within the sweep. Each match has the variance ``sigma^2`` plus its plane's own at the query.

    Parameters
    ----------
    local_map : LocalMap
        A `VoxelMap` is searched natively; any other is asked for planes and summed with NumPy.
    points_imu : (N, 3) float32
        De-skewed, imu frame at the sweep's end [m].
    T_odom_imu, T_imu_lidar : (4, 4) float64
        Pose to linearise at, and mounting.
    settings : MatchSettings

    Raises
    ------
    ConfigError
        An unknown residual, or point residuals on a map that has none.
    """
    if settings.residual not in ("plane", "point"):
        raise ConfigError(f"residual '{settings.residual}' is not one of 'plane', 'point'")
    if not isinstance(local_map, VoxelMap):
        return _linearize_any(local_map, points_imu, T_odom_imu, T_imu_lidar, settings)
    T = np.ascontiguousarray(T_odom_imu)
    if settings.residual == "plane":
        sums = _core.match_planes(
            local_map.native,
            points_imu,
            T,
            np.ascontiguousarray(T_imu_lidar),
            settings.gate,
            settings.kernel,
            settings.sigma,
            settings.fallback_stride,
            local_map.config.fallback_range,
            12 if settings.mounting else 6,
            settings.threads,
        )
    else:
        sums = _core.match_points(
            local_map.native, points_imu, T, settings.gate, settings.kernel, settings.sigma, settings.threads
        )
    return NormalEquations(
        information=sums[0],
        gradient=sums[1],
        weight=sums[2],
        robust_weight=sums[3],
        square=sums[4],
        cost=sums[5],
        matches=sums[6],
        fallback_matches=sums[7],
        queries=len(points_imu),
    )


def _linearize_any(
    local_map: LocalMap,
    points_imu: NDArray[np.float32],
    T_odom_imu: NDArray[np.float64],
    T_imu_lidar: NDArray[np.float64],
    settings: MatchSettings,
) -> NormalEquations:
    """Do the same for a user's own map, in NumPy."""
    if settings.residual == "point":
        raise ConfigError("point-to-point residuals exist for the voxel map only; use residual 'plane'")
    R, t = T_odom_imu[:3, :3], T_odom_imu[:3, 3]
    p = points_imu.astype(np.float64)
    found = local_map.planes_at(p @ R.T + t, gate=settings.gate)
    some = found.source > 0
    p, n = p[some], found.normal[some].astype(np.float64)
    r = np.einsum("ij,ij->i", n, p @ R.T + t - found.point[some])
    m = n @ R
    columns = [np.cross(p, m), n]
    if settings.mounting:
        R_il = T_imu_lidar[:3, :3]
        columns += [np.cross((p - T_imu_lidar[:3, 3]) @ R_il, m @ R_il), m]
    J = np.hstack(columns)
    c2 = settings.kernel**2
    w = (c2 / (c2 + r * r)) ** 2 if c2 > 0.0 else np.ones_like(r)
    rho = 0.5 * r * r * (c2 / (c2 + r * r) if c2 > 0.0 else 1.0)
    inv_var = 1.0 / (settings.sigma**2 + found.variance[some])
    weighted = J * (w * inv_var)[:, None]
    return NormalEquations(
        information=weighted.T @ J,
        gradient=weighted.T @ r,
        weight=float((w * inv_var).sum()),
        robust_weight=float(w.sum()),
        square=float((w * r * r).sum()),
        cost=float((rho * inv_var).sum()),
        matches=int(some.sum()),
        fallback_matches=int((found.source == 255).sum()),
        queries=len(points_imu),
    )
