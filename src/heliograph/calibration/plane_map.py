"""The map that a calibration places scans in: planes that two sizes of cubes agree on, cut at an angle to the walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from heliograph.arrays import Array, Mask, Points
from heliograph.config import MapConfig
from heliograph.lie import se3, so3
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings, NormalEquations, gradient_scatter, linearize

__all__ = ["PlaneMap", "turn_against"]


_MAX_AVERAGED = 1_000_000  # points a cube averages: unlike an odometry's map, this one is made of all scans at once
_MIN_COSINE, _MAX_DISTANCE = 0.998, 0.008  # normals' cosine and distance [m] within which two planes are one
_MIN_SHARE = 0.25  # share of a scan's matches that must lie on such planes, or all are used
_TURN_CANDIDATES = 64


class PlaneMap:
    """Planes of all scans, for the poses of single scans to a tenth of a millimetre.

    Errors of a map of cubes that are far below an odometry's noise are too large here, because they are alike from scan
    to scan:

    * Where a wall lies in a face of the cubes, a point's noise decides which cube it is looked up in, and each of the
      two holds the mean of the points on its own side. Residuals then hardly move with the scan: the solution takes
      dozens of steps, and ends near where it began after a few. So the cubes are turned against the walls.
    * A cube at an edge holds a sliver of the other surface, thin enough to pass as noise, and its plane leans. So a
      plane counts only where the cube of twice the size has it too.
    * What is left depends on where the cubes happen to lie. So there are several sets of them, and their equations are
      averaged.
    * A range's noise moves a point along its beam, so also along the surface, and where the density of the points falls
      with the distance, more of those in a cube are too far than too near: planes seen under an angle lie behind the
      surface. So the noise is laid across the surface before points are added; see `across_planes`.

    Parameters
    ----------
    config : MapConfig
        Edge and levels of the cubes, and what their planes need; ``max_points`` is not used.
    R_cubes_odom : (K, 3, 3) float64
        Attitudes of the K sets of cubes against the odom frame; see `turn_against`.

    Notes
    -----
    Points are of the lidar frame, float32 and C-contiguous; poses take them to the odom frame [m]. The map grows with
    every scan that is inserted and forgets nothing.
    """

    def __init__(self, config: MapConfig, R_cubes_odom: Array) -> None:
        self._sets = tuple(_Cubes(config, R) for R in R_cubes_odom)

    def insert(self, points: Points, T_odom_lidar: Array) -> None:
        """Add a scan's points to every set of cubes.

        Parameters
        ----------
        points : (N, 3) float32
            De-skewed, lidar frame [m].
        T_odom_lidar : (4, 4) float64
            Pose of the LiDAR at the scan's instant [m].
        """
        for cubes in self._sets:
            cubes.insert(points, T_odom_lidar)

    def normals(self) -> tuple[Array, Array]:
        """Return the planes of the first set's finest cubes.

        Returns
        -------
        normals : (M, 3) float64
            Unit normals, odom axes; either sign.
        counts : (M,) float64
            Points in each.
        """
        return self._sets[0].normals()

    def across_planes(self, points: Points, T_odom_lidar: Array, gate: float) -> Points:
        """Return points with the distance to their plane of the first set laid along its normal instead of their beam.

        Parameters
        ----------
        points : (N, 3) float32
            Lidar frame [m].
        T_odom_lidar : (4, 4) float64
        gate : float
            A point farther from its plane, along its beam, is no noise of that plane's and stays [m].

        Returns
        -------
        (N, 3) float32
            Lidar frame [m]; a point without a plane stays where it is.
        """
        return self._sets[0].across_planes(points, T_odom_lidar, gate)

    def agreeing_points(self, points: Points, T_odom_lidar: Array, gate: float) -> tuple[Mask, ...]:
        """Find the points that lie on planes which cubes of both sizes agree on.

        Parameters
        ----------
        points : (N, 3) float32
            Lidar frame [m].
        T_odom_lidar : (4, 4) float64
        gate : float
            Largest distance of a point from its plane [m].

        Returns
        -------
        K arrays (N,) of bool
            One for each set of cubes; all points where fewer than a quarter of its matches lie on such planes.
        """
        return tuple(cubes.agreeing_points(points, T_odom_lidar, gate) for cubes in self._sets)

    def linearize(
        self, points: Sequence[Points], T_odom_lidar: Array, settings: MatchSettings
    ) -> tuple[Array, Array, int]:
        """Linearise the distances of a scan's points to their planes about a pose, averaged over the sets of cubes.

        Parameters
        ----------
        points : K arrays (N_k, 3) float32
            Those that `agreeing_points` chose for each set of cubes, lidar frame [m].
        T_odom_lidar : (4, 4) float64
            Pose to linearise at.
        settings : MatchSettings
            Noise, kernel and gate of the matches.

        Returns
        -------
        information : (6, 6) float64
            For right perturbations of the pose: turns about and shifts along the lidar axes [1/rad^2], [1/m^2].
        gradient : (6,) float64
            Sum of ``w / s^2 J^T r`` over the matches, in the same order.
        matches : int
            The fewest that a set of cubes has.
        """
        each = [cubes.linearize(some, T_odom_lidar, settings) for cubes, some in zip(self._sets, points, strict=True)]
        turns = self._turns(T_odom_lidar)
        information = np.einsum("kai,kab,kbj->ij", turns, np.stack([e.information for e in each]), turns)
        gradient = np.einsum("kai,ka->i", turns, np.stack([e.gradient for e in each]))
        return information / len(each), gradient / len(each), min(e.matches for e in each)

    def scatter(self, points: Sequence[Points], T_odom_lidar: Array, settings: MatchSettings) -> Array:
        """Return the covariance of the gradient, as the residuals of the single matches show it.

        The sets of cubes look at the same points, so their gradients' errors are taken as one.

        Parameters
        ----------
        points, T_odom_lidar, settings
            As for `linearize`.

        Returns
        -------
        (6, 6) float64
            In the order of `linearize`.
        """
        each = [cubes.scatter(some, T_odom_lidar, settings) for cubes, some in zip(self._sets, points, strict=True)]
        turns = self._turns(T_odom_lidar)
        return np.asarray(np.einsum("kai,kab,kbj->ij", turns, np.stack(each), turns) / len(each))

    def _turns(self, T_odom_lidar: Array) -> Array:
        """Return what takes errors along lidar axes to the registrations', (K, 6, 6): position along the cubes."""
        turns = np.tile(np.eye(6), (len(self._sets), 1, 1))
        turns[:, 3:, 3:] = [cubes.R_cubes_odom @ T_odom_lidar[:3, :3] for cubes in self._sets]
        return turns


class _Cubes:
    """Cubes of one attitude, in the fine map's levels and once more at twice its finest size."""

    def __init__(self, config: MapConfig, R_cubes_odom: Array) -> None:
        self._fine = VoxelMap(replace(config, max_points=_MAX_AVERAGED))
        self._coarse = VoxelMap(replace(config, max_points=_MAX_AVERAGED, voxel=2.0 * config.voxel, levels=1))
        self.R_cubes_odom = R_cubes_odom
        self._T_cubes_odom = se3.from_rotation_translation(R_cubes_odom, np.zeros(3))

    def insert(self, points: Points, T_odom_lidar: Array) -> None:
        T_cubes_lidar = self._T_cubes_odom @ T_odom_lidar
        self._fine.insert(points, T_cubes_lidar)
        # Twice the edge and a quarter of the points: as many in a cube as the fine ones have.
        self._coarse.insert(np.ascontiguousarray(points[::4]), T_cubes_lidar)

    def normals(self) -> tuple[Array, Array]:
        table = self._fine.table()
        planes = table[(table[:, 0] == table[:, 0].min()) & (table[:, 11] >= 0.0)] if len(table) else table
        return planes[:, 5:8] @ self.R_cubes_odom, planes[:, 1]

    def across_planes(self, points: Points, T_odom_lidar: Array, gate: float) -> Points:
        T, p = self._T_cubes_odom @ T_odom_lidar, points.astype(np.float64)
        at = p @ T[:3, :3].T + T[:3, 3]
        found = self._fine.planes_at(at, gate=gate, neighbours=False)
        normal = found.normal @ T[:3, :3]
        across = np.einsum("ni,ni->n", found.normal, at - found.point, dtype=np.float64)
        length = np.linalg.norm(p, axis=1)
        cosine = np.einsum("ni,ni->n", normal, p) / np.maximum(length, 1e-9)
        noise = (found.source > 0) & (np.abs(across) < gate * np.abs(cosine))
        along = np.divide(across, cosine * length, out=np.zeros_like(across), where=noise)
        across = np.where(noise, across, 0.0)
        return np.ascontiguousarray(p - along[:, None] * p + across[:, None] * normal, dtype=np.float32)

    def agreeing_points(self, points: Points, T_odom_lidar: Array, gate: float) -> Mask:
        T = self._T_cubes_odom @ T_odom_lidar
        at = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        fine, coarse = (cubes.planes_at(at, gate=gate, neighbours=False) for cubes in (self._fine, self._coarse))
        cosine = np.einsum("ni,ni->n", fine.normal, coarse.normal, dtype=np.float64)
        by_fine = np.einsum("ni,ni->n", fine.normal, at - fine.point)
        by_coarse = np.sign(cosine) * np.einsum("ni,ni->n", coarse.normal, at - coarse.point)
        matched = fine.source > 0
        both = matched & (coarse.source > 0) & (np.abs(cosine) > _MIN_COSINE)
        both &= np.abs(by_fine - by_coarse) < _MAX_DISTANCE
        few = np.count_nonzero(both) < _MIN_SHARE * np.count_nonzero(matched)
        return np.ones(len(points), dtype=np.bool_) if few else np.asarray(both)

    def linearize(self, points: Points, T_odom_lidar: Array, settings: MatchSettings) -> NormalEquations:
        return linearize(self._fine, points, self._T_cubes_odom @ T_odom_lidar, settings)

    def scatter(self, points: Points, T_odom_lidar: Array, settings: MatchSettings) -> Array:
        return gradient_scatter(self._fine, points, self._T_cubes_odom @ T_odom_lidar, settings)


def turn_against(normals: Array, weights: Array, count: int) -> Array:
    """Return attitudes of cubes (count, 3, 3) whose faces are least parallel to planes.

    Parameters
    ----------
    normals : (M, 3) float64
        Odom axes.
    weights : (M,) float64
    count : int

    Returns
    -------
    (count, 3, 3) float64
        ``R_cubes_odom``, the best of some that spread over all.
    """
    turns = so3.exp(np.random.default_rng(0).uniform(-1.0, 1.0, (_TURN_CANDIDATES, 3)))
    along = np.abs(np.einsum("kij,mj->kmi", turns, normals)).max(axis=2)
    # A high power, for only walls within some 20 degrees of a face do harm.
    return np.asarray(turns[np.argsort((along**16) @ weights, kind="stable")[:count]])
