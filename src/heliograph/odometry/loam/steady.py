"""Pose and motion of a sweep at once, where no IMU says how it moved."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from heliograph.config import LoamConfig, RunConfig
from heliograph.data import NavState
from heliograph.data.error_layout import GYRO_BIAS, POSE, VELOCITY
from heliograph.imu import ImuPath
from heliograph.maps import FeatureMap, FeaturePoints
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.motion import sweep_path
from heliograph.odometry.filter.update import FilterUpdate, iterated_update
from heliograph.odometry.loam.sweep import FeatureSweep
from heliograph.registration import FeatureNoise, FeatureRegistration, SweepFeatures, true_share
from heliograph.snapshots import PART, Stateful

__all__ = ["ScanToScan", "registered_in_motion"]

_COLUMNS = np.concatenate([np.arange(part.start, part.stop) for part in (POSE, VELOCITY, GYRO_BIAS)])
_SETTLED_SIGMAS = 0.2  # of a planar point's noise that a last step moves the cloud by at most
_REACH = 2.0  # times as far as in the map may neighbours be: one sweep alone is sparse across its lines


def registered_in_motion(
    prior: NavState,
    path: ImuPath,
    sweep: FeatureSweep,
    local_map: FeatureMap,
    *,
    noise: FeatureNoise,
    config: RunConfig,
    opening: float,
    start: NavState | None = None,
    threads: int,
) -> tuple[FeatureRegistration, FilterUpdate[ScanMeasurement]]:
    """Find pose, velocity and rate at which a sweep's features lie on lines and planes of a map, eq. (11).

    Parameters
    ----------
    prior : NavState
        As predicted to the sweep's end.
    path : ImuPath
        The predicted motion.
    sweep : FeatureSweep
    local_map : FeatureMap
    noise : FeatureNoise
    config : RunConfig
    opening : float
        Scale of the kernel at first [m]; it halves from iteration to iteration.
    start : NavState, optional
        Where to begin; the prediction if not given.
    threads : int
        Threads of the native loops; the result does not depend on them.
    """
    settings = config.filter
    wide = max(opening / (settings.kernel * noise.plane), 1.0)
    narrow = int(np.ceil(np.log2(wide)))
    features = SweepFeatures(
        local_map, sweep.before_end, noise=noise, config=config.loam, settings=settings, threads=threads
    )
    last = None

    def measure(state: NavState, iteration: int) -> ScanMeasurement:
        nonlocal last
        points = sweep.points(sweep_path(path, prior, state))
        last = features.sums(points, state.T_odom_imu, max(wide * 0.5**iteration, 1.0))
        sums, seen = last[2], true_share(last[2])
        told = ScanMeasurement(
            columns=_COLUMNS, information=seen.information(), gradient=seen.gradient(sums.gradient), sums=sums
        )
        return told.scaled(1.0 / config.loam.correlation)

    update = iterated_update(
        prior,
        measure,
        max_iterations=2 * config.loam.max_iterations + narrow,
        tolerance_rotation=_SETTLED_SIGMAS * noise.plane / settings.typical_range,
        tolerance_position=_SETTLED_SIGMAS * noise.plane,
        settled=lambda iteration: iteration >= narrow,
        start=start,
    )
    assert last is not None
    edges, planes, sums = last
    found = FeatureRegistration(
        T_odom_body=update.state.T_odom_imu,
        edges=edges,
        planes=planes,
        sums=sums,
        seen=true_share(sums, sums.columns_of("pose")),
        iterations=update.iterations,
        converged=update.converged,
    )
    return found, update


class ScanToScan(Stateful):
    """LOAM's odometry: registers a sweep to the one before it.

    Parameters
    ----------
    config : RunConfig
    threads : int
        Threads of the native loops; the results do not depend on them.
    """

    _STATE: ClassVar = {"last": PART, "noise": FeatureNoise}

    def __init__(self, config: RunConfig, *, threads: int) -> None:
        self.last = FeatureMap(_of_one_sweep(config.loam))
        """Features of the sweep before."""
        self.noise = FeatureNoise(edge=config.loam.edge_sigma, plane=config.loam.plane_sigma)
        self._config, self._threads = config, threads

    def led(self, prior: NavState, path: ImuPath, sweep: FeatureSweep, opening: float) -> NavState:
        """Return the state that the sweep before tells, or the prediction where it tells none.

        Parameters
        ----------
        prior : NavState
            As predicted to the end of this one.
        path : ImuPath
            The predicted motion.
        sweep : FeatureSweep
        opening : float
            Scale of the kernel at first [m].
        """
        least = self._config.filter.min_matches
        if len(self.last) == 0 or sweep.count < least:
            return prior
        found, update = registered_in_motion(
            prior,
            path,
            sweep,
            self.last,
            noise=self.noise,
            config=self._config,
            opening=opening,
            threads=self._threads,
        )
        if found.sums.matches < least:
            return prior
        self.noise = self.noise.updated(found, self._config.filter)
        return update.state

    def remember(self, points: FeaturePoints, state: NavState) -> None:
        """Hold the features of a sweep, imu frame at its end, for the next."""
        self.last.clear()
        self.last.insert(points, state.T_odom_imu)


def _of_one_sweep(config: LoamConfig) -> LoamConfig:
    return replace(
        config,
        edge_voxel=0.5 * config.edge_voxel,
        plane_voxel=0.5 * config.plane_voxel,
        edge_reach=_REACH * config.edge_reach,
        plane_reach=_REACH * config.plane_reach,
    )
