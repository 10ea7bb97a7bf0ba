"""The map that a calibration places scans in: planes that two sizes of cubes agree on, cut at an angle to the walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.config import MapConfig
from heliograph.lie import so3
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings, NormalEquations, linearize

__all__ = ["PlaneMap", "turn_against"]

Array = NDArray[np.float64]
Points = NDArray[np.float32]

_AVERAGED = 1_000_000  # points a cube averages: unlike an odometry's map, this one is made of all scans at once
_PARALLEL, _APART = 0.998, 0.008  # normals' cosine and distance [m] within which two planes are one
_ENOUGH = 0.25  # share of a scan's matches that must lie on such planes, or all are used
_TURNS = 64


class PlaneMap:
    """Planes of all scans, for the poses of single scans to a tenth of a millimetre.

    Two errors of a map of cubes, each far below an odometry's noise, are too large here because they are alike from
    scan to scan:

    * Where a wall lies in a face of the cubes, a point's noise decides which cube it is looked up in, and each of the
      two holds the mean of the points on its own side. Residuals then hardly move with the scan: the solution takes
      dozens of steps, and ends near where it began after a few. So the cubes are turned against the walls.
    * A cube at an edge holds a sliver of the other surface, thin enough to pass as noise, and its plane leans. So a
      plane counts only where the cube of twice the size has it too.

    Parameters
    ----------
    config : MapConfig
    R_map_odom : (3, 3) float64
        Attitude of the cubes; see `turn_against`.
    """

    def __init__(self, config: MapConfig, R_map_odom: Array) -> None:
        self._fine = VoxelMap(replace(config, max_points=_AVERAGED))
        self._coarse = VoxelMap(replace(config, max_points=_AVERAGED, voxel=2.0 * config.voxel, levels=1))
        self._T_map_odom = np.eye(4)
        self._T_map_odom[:3, :3] = R_map_odom

    def insert(self, points: Points, T_odom_lidar: Array) -> None:
        """Add points (N, 3) of the lidar frame [m]."""
        T_map_lidar = self._T_map_odom @ T_odom_lidar
        self._fine.insert(points, T_map_lidar)
        self._coarse.insert(points, T_map_lidar)

    def normals(self) -> tuple[Array, Array]:
        """Return the normals of the finest planes (M, 3), odom axes, and how many points each has (M,)."""
        table = self._fine.table()
        planes = table[(table[:, 0] == table[:, 0].min()) & (table[:, 11] >= 0.0)] if len(table) else table
        return planes[:, 5:8] @ self._T_map_odom[:3, :3], planes[:, 1]

    def settled(self, points: Points, T_odom_lidar: Array, gate: float) -> Points:
        """Return the points that lie on planes of both sizes; all of them where those are too few."""
        T = self._T_map_odom @ T_odom_lidar
        at = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        fine, coarse = self._fine.planes_at(at, gate=gate), self._coarse.planes_at(at, gate=gate)
        cosine = np.einsum("ni,ni->n", fine.normal, coarse.normal, dtype=np.float64)
        by_fine = np.einsum("ni,ni->n", fine.normal, at - fine.point)
        by_coarse = np.sign(cosine) * np.einsum("ni,ni->n", coarse.normal, at - coarse.point)
        matched = _on_plane(fine.source)
        both = matched & _on_plane(coarse.source) & (np.abs(cosine) > _PARALLEL)
        both &= np.abs(by_fine - by_coarse) < _APART
        few = np.count_nonzero(both) < _ENOUGH * np.count_nonzero(matched)
        return points if few else np.ascontiguousarray(points[both])

    def linearize(self, points: Points, T_odom_lidar: Array, settings: MatchSettings) -> NormalEquations:
        """Return the normal equations of the points, for turns and shifts (6,) along lidar axes."""
        T_map_lidar = self._T_map_odom @ T_odom_lidar
        equations = linearize(self._fine, points, T_map_lidar, np.eye(4), settings)
        # The registration's position error is along the map's axes; a right perturbation's is along the body's.
        turn = np.eye(6)
        turn[3:, 3:] = T_map_lidar[:3, :3]
        return replace(
            equations, information=turn.T @ equations.information @ turn, gradient=turn.T @ equations.gradient
        )


def _on_plane(source: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Whether matches are with a cube's own plane: 0 is none, 255 one through neighbours."""
    return np.asarray((source > 0) & (source < 255))


def turn_against(normals: Array, weights: Array) -> Array:
    """Return an attitude of cubes (3, 3) whose faces are least parallel to planes.

    Parameters
    ----------
    normals : (M, 3) float64
        Odom axes.
    weights : (M,) float64

    Returns
    -------
    (3, 3) float64
        ``R_map_odom``, of some that spread over all.
    """
    turns = so3.exp(np.random.default_rng(0).uniform(-1.0, 1.0, (_TURNS, 3)))
    along = np.abs(np.einsum("kij,mj->kmi", turns, normals)).max(axis=2)
    # A high power, for only walls within some 20 degrees of a face do harm.
    return np.asarray(turns[np.argmin((along**16) @ weights)])
