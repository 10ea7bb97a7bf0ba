"""Tracking in a saved map: odometry in front, each scan's match to the map behind, and what contradicts the place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, Points
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import ScanResult
from heliograph.lie import se3
from heliograph.localization.saved_map import SavedMap
from heliograph.odometry.filter.matching import AdaptiveNoise, Thinning
from heliograph.registration import MatchSettings, NormalEquations, linearize, true_share
from heliograph.slam.covariances import graph_covariance, graph_information, step_covariance
from heliograph.slam.loops.tangent import diagonal

__all__ = ["MapTracker", "TrackedScan"]

_ITERATIONS = 6
_STEP = 1e-4  # a shorter step ends the iterations [rad], [m]
_GAIN = 0.1  # weight of a new scan in the usual share of matches
_SETTLING = 10  # scans until the usual share is known


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackedScan:
    """What matching a scan to the map gave.

    Parameters
    ----------
    matched : float
        Share of its points that lie on a surface of the map.
    nis : float
        Squared correction over what the prediction and the map's slack allow; about 6 at most.
    contradicts : bool
        Whether it speaks against the place.
    """

    matched: float
    nis: float
    contradicts: bool


class MapTracker:
    """The pose in a map: it changes by odometry's steps and by what scans see of the map's surfaces.

    Parameters
    ----------
    saved : SavedMap
    config : RunConfig
    T_map_odom : (4, 4) float64
        Where it begins.
    covariance : (6, 6) float64
        Covariance of the pose, right perturbation.
    result : ScanResult
        The scan that it was found at.
    threads : int
        The result does not depend on it.
    """

    def __init__(
        self,
        saved: SavedMap,
        config: RunConfig,
        T_map_odom: Array,
        covariance: Array,
        result: ScanResult,
        *,
        threads: int = 1,
    ) -> None:
        self.T_map_odom, self._P = T_map_odom, covariance
        self._saved, self._config, self._threads = saved, config, threads
        self._noise = AdaptiveNoise(config.filter.sigma)
        self._thinning = Thinning(replace(config.cloud, target_points=config.localization.points))
        self._last = result
        self._usual, self._scans = 0.0, 0

    @property
    def covariance(self) -> Array:
        """Covariance of the pose at the last scan, right perturbation (6, 6), with the map's own."""
        T = self.T_map_odom @ self._last.T_odom_imu
        submap = self._saved.nearest(T)
        carry = se3.adjoint(se3.inverse(T) @ submap.T_map_submap)
        return np.asarray(self._P + carry @ submap.covariance @ carry.T)

    def step(self, result: ScanResult) -> TrackedScan:
        """Carry the pose to the next scan and match that to the map."""
        T_prior, P = self._predicted(result)
        points = result.points_imu[self._thinning.pick(result.points_imu)]
        T, sums, information = self._fitted(points, T_prior, P)
        share = sums.matches / max(sums.queries, 1)
        nis = self._off(T_prior, T, P)
        told = self._config.localization
        few = sums.matches < self._config.filter.min_matches or share < told.matched_share * self._usual
        contradicts = few or nis > chi_square_quantile(told.gate_probability, 6)
        self._last = result
        if contradicts:  # odometry carries it on
            self._P = P
            return TrackedScan(matched=share, nis=nis, contradicts=True)
        self._scans += 1
        self._usual += max(_GAIN, 1.0 / min(self._scans, _SETTLING)) * (share - self._usual)
        self._noise = self._noise.updated(sums.rms, self._config.filter)
        self._P = np.asarray(np.linalg.inv(np.linalg.inv(P) + information))
        self.T_map_odom = np.ascontiguousarray(T @ se3.inverse(result.T_odom_imu))
        return TrackedScan(matched=share, nis=nis, contradicts=False)

    def _predicted(self, result: ScanResult) -> tuple[Array, Array]:
        """Return the pose that odometry leads to, and its covariance."""
        before, told = self._last, self._config.localization
        step = se3.inverse(before.T_odom_imu) @ result.T_odom_imu
        way = float(np.linalg.norm(step[:3, 3])) + float(np.linalg.norm(step[:3, :3] - np.eye(3)))
        least = np.sqrt(way) * np.repeat([np.radians(told.rotation_walk_deg), told.position_walk], 3)
        Q = step_covariance(
            before.T_odom_imu,
            result.T_odom_imu,
            graph_covariance(before.pose_covariance, before.T_odom_imu),
            graph_covariance(result.pose_covariance, result.T_odom_imu),
            np.maximum(least, 1e-6),
        )
        carry = se3.adjoint(se3.inverse(step))
        return self.T_map_odom @ result.T_odom_imu, np.asarray(carry @ self._P @ carry.T + Q)

    def _fitted(self, points: Points, T_prior: Array, P: Array) -> tuple[Array, NormalEquations, Array]:
        """Return pose, last equations, and the information that the match adds about a right perturbation."""
        settings, told = self._config.filter, self._config.localization
        unknown = float(np.sqrt(np.linalg.eigvalsh(P[3:, 3:])[-1] + 15.0**2 * np.linalg.eigvalsh(P[:3, :3])[-1]))
        final = settings.kernel * self._noise.sigma
        scale = float(np.clip(2.0 * unknown, final, settings.max_kernel))
        prior, T = np.asarray(np.linalg.inv(P)), T_prior
        H = np.zeros((6, 6))
        for k in range(_ITERATIONS):
            matching = MatchSettings(
                gate=settings.gate * scale,
                kernel=scale,
                sigma=self._noise.sigma,
                fallback_stride=settings.fallback_stride,
                threads=self._threads,
            )
            sums = linearize(self._saved.surfaces, points, np.ascontiguousarray(T), matching)
            seen = true_share(sums)
            H = np.asarray(graph_information(seen.information(), T) / told.correlation, dtype=np.float64)
            b = seen.gradient(sums.gradient) / told.correlation
            pull = np.concatenate([b[:3], T[:3, :3].T @ b[3:]]) + prior @ se3.local(T_prior, T)
            d = np.linalg.solve(H + prior, -pull)
            if scale <= final and float(np.abs(d).max()) < _STEP and k > 0:
                break
            T = np.asarray(se3.retract(T, d))
            scale = max(0.5 * scale, final)
        return T, sums, H

    def _off(self, T_prior: Array, T: Array, P: Array) -> float:
        told = self._config.localization
        d = se3.local(T_prior, T)
        return float(d @ np.linalg.solve(P + diagonal(told.slack_deg, told.slack), d))
