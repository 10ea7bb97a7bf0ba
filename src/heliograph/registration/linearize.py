"""Normal equations of point-to-plane residuals, ``r = n . (R p + t - c)``, under a robust kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, as_pose, freeze
from heliograph.errors import ConfigError
from heliograph.maps import NEIGHBOURS, LocalMap, PlaneMatches, VoxelMap

__all__ = ["BLOCKS", "MapMounting", "MatchSettings", "NormalEquations", "gradient_scatter", "linearize"]


BLOCKS = ("pose", "motion", "mounting")
"""What the columns of the normal equations may be, in their order, six each.

``"pose"``: rotation about body axes (right perturbation) and position along odom axes; always there. ``"motion"``:
velocity along odom axes and gyroscope bias. ``"mounting"``: rotation about lidar axes (right) and lever arm along imu
axes.
"""

_BLOCK = 6


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
        Every ``fallback_stride``-th point without a plane asks for its neighbours; 0: none.
    residual : str
        ``"plane"``, or ``"point"``: the distance to the nearest stored point, for comparison only. Its information is
        the identity whatever the geometry, so it cannot see a degenerate one.
    threads : int
        Threads of the native loop; the result does not depend on them.
    """

    gate: float
    kernel: float
    sigma: float
    fallback_stride: int = 1
    residual: str = "plane"
    threads: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMounting:
    """The mounting behind a map whose points it brought into the body frame.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        The mounting that map and scan were made with [m].
    T_odom_imu_first : (4, 4) float64
        Pose that the map was begun at [m].
    """

    T_imu_lidar: NDArray[np.float64]
    T_odom_imu_first: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("T_imu_lidar", "T_odom_imu_first"):
            object.__setattr__(self, name, as_pose(name, getattr(self, name)))
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalEquations:
    """Sums over the matches.

    Parameters
    ----------
    blocks : tuple of str
        What the columns are, six each, out of `BLOCKS` in that order.
    information : (C, C) float64
        Sum of ``w / s^2 J^T J``.
    gradient : (C,) float64
        Sum of ``w / s^2 J^T r``.
    feigned : (C, C) float64
        What noise of the planes' normals alone is expected to have added to ``information``: sum of
        ``w / s^2 E[dJ^T dJ]`` over pose and motion, zero for the mounting.
    feigned_square : float
        Sum of the squares of ``w / s^2`` times the normal's variance, for the scatter of that.
    weight : float
        Sum of ``w / s^2`` [1/m^2].
    robust_weight, square : float
        Sums of ``w`` and of ``w r^2`` [m^2]; the root of their quotient is the robust RMS.
    cost : float
        Sum of ``rho(r) / s^2``.
    matches, fallback_matches, queries : int
        Points with a plane, those of them with one through neighbours, and all that asked.
    """

    blocks: tuple[str, ...]
    information: NDArray[np.float64]
    gradient: NDArray[np.float64]
    feigned: NDArray[np.float64]
    feigned_square: float
    weight: float
    robust_weight: float
    square: float
    cost: float
    matches: int
    fallback_matches: int
    queries: int

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def rms(self) -> float:
        """Robust root mean square of the residuals [m]; NaN without matches."""
        return float(np.sqrt(self.square / self.robust_weight)) if self.robust_weight > 0.0 else float("nan")

    def columns_of(self, block: str) -> slice:
        """Return where the columns of a block stand."""
        first = _BLOCK * self.blocks.index(block)
        return slice(first, first + _BLOCK)


def linearize(
    local_map: LocalMap,
    points_imu: NDArray[np.float32],
    T_odom_imu: NDArray[np.float64],
    settings: MatchSettings,
    *,
    before_end: NDArray[np.float32] | None = None,
    mounted: MapMounting | None = None,
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
        De-skewed, imu frame at the sweep's end [m]. One that is not finite finds no plane.
    T_odom_imu : (4, 4) float64
        Pose to linearise at.
    settings : MatchSettings
    before_end : (N,) float32, optional
        Time of each point before the sweep's end [s]; adds the columns of the motion.
    mounted : MapMounting, optional
        Adds the columns of the mounting. Planes through neighbours tell nothing about it: their points come from
        several poses.

    Raises
    ------
    ConfigError
        An unknown residual, or point residuals on a map that has none.
    DataError
        An array of another dtype or shape, or a pose that is not finite.
    """
    if settings.residual not in ("plane", "point"):
        raise ConfigError(f"residual '{settings.residual}' is not one of 'plane', 'point'")
    points_imu, T_odom_imu = as_points("points_imu", points_imu), as_pose("T_odom_imu", T_odom_imu)
    if before_end is not None:
        before_end = as_array("before_end", before_end, np.float32, (len(points_imu),))
    if isinstance(local_map, VoxelMap):
        return _linearize_native(local_map, points_imu, T_odom_imu, settings, before_end, mounted)
    return _linearize_any(local_map, points_imu, T_odom_imu, settings, before_end, mounted)


def _blocks(before_end: NDArray[np.float32] | None, mounted: MapMounting | None) -> tuple[str, ...]:
    there = {"pose": True, "motion": before_end is not None, "mounting": mounted is not None}
    return tuple(block for block in BLOCKS if there[block])


def _linearize_native(
    local_map: VoxelMap,
    points_imu: NDArray[np.float32],
    T_odom_imu: NDArray[np.float64],
    settings: MatchSettings,
    before_end: NDArray[np.float32] | None,
    mounted: MapMounting | None,
) -> NormalEquations:
    unused = np.eye(4)
    scan = (
        local_map.native,
        points_imu,
        before_end if before_end is not None else np.zeros(0, np.float32),
        T_odom_imu,
        mounted.T_imu_lidar if mounted is not None else unused,
        mounted.T_odom_imu_first if mounted is not None else unused,
        settings.gate,
        settings.kernel,
        settings.sigma,
    )
    asked = (before_end is not None, mounted is not None, settings.threads)
    if settings.residual == "plane":
        sums = _core.match_planes(*scan, settings.fallback_stride, local_map.config.fallback_range, *asked)
    else:
        sums = _core.match_points(*scan, *asked)
    return _from_sums(sums, _blocks(before_end, mounted), len(points_imu))


def _from_sums(sums: Any, blocks: tuple[str, ...], queries: int) -> NormalEquations:  # noqa: ANN401
    """Add to the named sums of the native kernels what they are of."""
    return NormalEquations(
        blocks=blocks,
        information=sums.information,
        gradient=sums.gradient,
        feigned=sums.feigned,
        feigned_square=sums.feigned_square,
        weight=sums.weight,
        robust_weight=sums.robust_weight,
        square=sums.square,
        cost=sums.cost,
        matches=sums.matches,
        fallback_matches=sums.fallback_matches,
        queries=queries,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Matches:
    """Matches one by one: Jacobian (M, C), residual (M,), robust weight (M,), inverse variance (M,), source (M,).

    `across` (M, 2, C) is how the row changes by a unit tilt of the normal about either axis across it, `tilt` (M,) the
    variance of those.
    """

    J: NDArray[np.float64]
    r: NDArray[np.float64]
    w: NDArray[np.float64]
    inv_var: NDArray[np.float64]
    source: NDArray[np.uint8]
    across: NDArray[np.float64]
    tilt: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self)


def _matched(
    found: PlaneMatches,
    points: NDArray[np.float64],
    T: NDArray[np.float64],
    settings: MatchSettings,
    before_end: NDArray[np.float32] | None = None,
    mounted: MapMounting | None = None,
) -> _Matches:
    some = found.source > 0
    p, n = points[some], found.normal[some].astype(np.float64)
    q = p @ T[:3, :3].T + T[:3, 3]
    r = np.einsum("ij,ij->i", n, q - found.point[some])
    dt = before_end[some, None].astype(np.float64) if before_end is not None else None
    columns = _pose_and_motion(p, n, T, dt)
    across = [np.hstack(_pose_and_motion(p, t, T, dt)) for t in _across(n)]
    if mounted is not None:
        here, first = (_mounting_columns(q, n, X, mounted.T_imu_lidar) for X in (T, mounted.T_odom_imu_first))
        columns.append(np.where(found.source[some, None] == NEIGHBOURS, 0.0, here - first))
    c2 = settings.kernel**2
    return _Matches(
        J=np.hstack(columns),
        r=r,
        w=(c2 / (c2 + r * r)) ** 2 if c2 > 0.0 else np.ones_like(r),
        inv_var=np.asarray(1.0 / (settings.sigma**2 + found.variance[some]), dtype=np.float64),
        source=found.source[some],
        across=np.pad(np.stack(across, axis=1), ((0, 0), (0, 0), (0, 6 if mounted is not None else 0))),
        tilt=found.tilt[some].astype(np.float64) if found.tilt is not None else np.zeros(len(p)),
    )


def _pose_and_motion(
    p: NDArray[np.float64], n: NDArray[np.float64], T: NDArray[np.float64], dt: NDArray[np.float64] | None
) -> list[NDArray[np.float64]]:
    """Return the columns of pose, and of motion for times dt (M, 1), that normals n (M, 3) make of points p (M, 3)."""
    turn = np.cross(p, n @ T[:3, :3])
    return [turn, n] if dt is None else [turn, n, -dt * n, dt * turn]


def _across(n: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors (M, 3) across each normal (M, 3) and each other."""
    a = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return a, np.cross(n, a)


def _mounting_columns(
    q: NDArray[np.float64], n: NDArray[np.float64], T_odom_imu: NDArray[np.float64], T_imu_lidar: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far a mounting error moves points q (M, 3) seen from a pose along n (M, 3), odom frame, (M, 6)."""
    m = n @ T_odom_imu[:3, :3]
    p_imu = (q - T_odom_imu[:3, 3]) @ T_odom_imu[:3, :3]
    p_lidar = (p_imu - T_imu_lidar[:3, 3]) @ T_imu_lidar[:3, :3]
    return np.hstack([np.cross(p_lidar, m @ T_imu_lidar[:3, :3]), m])


def gradient_scatter(
    local_map: VoxelMap, points: NDArray[np.float32], T_odom_body: NDArray[np.float64], settings: MatchSettings
) -> NDArray[np.float64]:
    """Return the sum of ``(w / s^2 r)^2 J^T J`` over the matches, (6, 6), rows as in `linearize`.

    With the information A it gives the covariance ``A^-1 B A^-1`` of the pose for noise that differs from point to
    point, as that of a range seen under a flat angle does (H. White, 1980). Points without a plane are left out.

    Raises
    ------
    DataError
        An array of another dtype or shape, or a pose that is not finite.
    """
    p, T_odom_body = as_points("points", points).astype(np.float64), as_pose("T_odom_body", T_odom_body)
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
    mounted: MapMounting | None,
) -> NormalEquations:
    """Do the same for a user's own map, in NumPy."""
    if settings.residual == "point":
        raise ConfigError("point-to-point residuals exist for the voxel map only; use residual 'plane'")
    p = points_imu.astype(np.float64)
    planes = local_map.planes_at(p @ T_odom_imu[:3, :3].T + T_odom_imu[:3, 3], gate=settings.gate)
    found = _matched(planes, p, T_odom_imu, settings, before_end, mounted)
    r, w, c2 = found.r, found.w, settings.kernel**2
    rho = 0.5 * r * r * (c2 / (c2 + r * r) if c2 > 0.0 else 1.0)
    weighted = found.J * (w * found.inv_var)[:, None]
    feigned = w * found.inv_var * found.tilt
    return NormalEquations(
        blocks=_blocks(before_end, mounted),
        information=weighted.T @ found.J,
        gradient=weighted.T @ r,
        feigned=np.einsum("m,mki,mkj->ij", feigned, found.across, found.across),
        feigned_square=float(feigned @ feigned),
        weight=float((w * found.inv_var).sum()),
        robust_weight=float(w.sum()),
        square=float((w * r * r).sum()),
        cost=float((rho * found.inv_var).sum()),
        matches=len(r),
        fallback_matches=int((found.source == NEIGHBOURS).sum()),
        queries=len(points_imu),
    )
