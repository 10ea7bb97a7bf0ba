"""A scan's pose on the map of features, and what it tells the state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import RunConfig
from heliograph.data import NavState
from heliograph.data.error_layout import POSE, POSITION, ROTATION
from heliograph.imu import ImuPath
from heliograph.lie import so3
from heliograph.maps import FeatureMap
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.motion import sweep_path
from heliograph.odometry.filter.update import FilterUpdate, iterated_update
from heliograph.odometry.loam.steady import registered_in_motion
from heliograph.odometry.loam.sweep import FeatureSweep
from heliograph.registration import FeatureNoise, FeatureRegistration, TrueShare, register_features
from heliograph.snapshots import Stateful

__all__ = ["FeatureMatcher", "PoseFit", "anchored", "fused"]

_OPENING_SIGMAS = 3.0  # of the predicted pose, that the first kernel is as wide as
_SHARE_GAIN = 0.1  # of a new scan in the share of features that usually match
_SAME = 0.005  # a motion of the sweep that differs by less at the typical range needs no second registration [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFit:
    """A scan's registration, and the state that it led to."""

    registration: FeatureRegistration
    update: FilterUpdate[ScanMeasurement]
    seen: TrueShare

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def state(self) -> NavState:
        """The state at the scan's end."""
        return self.update.state


class FeatureMatcher(Stateful):
    """Registers sweeps to a map of features, and remembers how noisy they are and how many of them usually match.

    Parameters
    ----------
    config : RunConfig
    threads : int
        Threads of the native loops; the results do not depend on them.
    """

    _STATE: ClassVar = {
        "noise": FeatureNoise,
        "_usual_share": float,
    }

    def __init__(self, config: RunConfig, *, threads: int) -> None:
        self.noise = FeatureNoise(edge=config.loam.edge_sigma, plane=config.loam.plane_sigma)
        self._config, self._threads = config, threads
        self._usual_share = 0.0

    def match(self, prior: NavState, path: ImuPath, sweep: FeatureSweep, local_map: FeatureMap) -> PoseFit | None:
        """Return the fit of a sweep to the map, None where too few features match to trust it.

        Parameters
        ----------
        prior : NavState
            As predicted to the sweep's end.
        path : ImuPath
            As predicted, the motion to de-skew with.
        sweep : FeatureSweep
        local_map : FeatureMap
        """
        if len(local_map) == 0 or sweep.count < self._config.filter.min_matches:
            return None
        fit = self._fitted(prior, path, sweep, local_map)
        if fit is not None:
            self._learn(fit.registration)
        return fit

    def match_in_motion(
        self, prior: NavState, start: NavState, path: ImuPath, sweep: FeatureSweep, local_map: FeatureMap
    ) -> PoseFit | None:
        """Return the fit of a sweep whose motion is found along, None where it is not to be trusted.

        Parameters
        ----------
        prior, start : NavState
            As predicted to the sweep's end, and where to begin.
        path : ImuPath
            As predicted.
        sweep : FeatureSweep
        local_map : FeatureMap
        """
        if len(local_map) == 0 or sweep.count < self._config.filter.min_matches:
            return None
        found, update = registered_in_motion(
            prior,
            path,
            sweep,
            local_map,
            noise=self.noise,
            config=self._config,
            opening=self.opening(prior),
            start=start,
            threads=self._threads,
        )
        if not self._trusted(prior, prior, found):
            return None
        self._learn(found)
        return PoseFit(registration=found, update=update, seen=found.seen)

    def _fitted(
        self, prior: NavState, predicted: ImuPath, sweep: FeatureSweep, local_map: FeatureMap
    ) -> PoseFit | None:
        """Register points that are de-skewed along the prediction, and again where the state found bends the sweep."""
        fit, start, path = None, prior, predicted
        for _ in range(self._config.loam.passes):
            found = self._register(prior, start, sweep, path, local_map)
            better = self._fit(prior, start, found)
            if better is None:
                break
            fit, start = better, better.state
            before, path = path, sweep_path(predicted, prior, start)
            if _moved(before, path, self._config.filter.typical_range) < _SAME:
                break
        return fit

    def _fit(self, prior: NavState, start: NavState, found: FeatureRegistration) -> PoseFit | None:
        """Return what a registration makes of the state, None where it is not to be trusted."""
        if not self._trusted(prior, start, found):
            return None
        return PoseFit(registration=found, update=fused(prior, found, self._config), seen=found.seen)

    def opening(self, prior: NavState) -> float:
        """Return how wide a kernel a prediction asks for at first [m]."""
        return min(_OPENING_SIGMAS * self._unknown(prior), self._config.filter.max_kernel)

    def _register(
        self, prior: NavState, state: NavState, sweep: FeatureSweep, path: ImuPath, local_map: FeatureMap
    ) -> FeatureRegistration:
        return register_features(
            local_map,
            sweep.points(path),
            state.T_odom_imu,
            noise=self.noise,
            config=self._config.loam,
            settings=self._config.filter,
            opening=self.opening(prior),
            threads=self._threads,
        )

    def _unknown(self, prior: NavState) -> float:
        """Return how far off the prediction may place a point at the typical range, one sigma [m]."""
        position = float(np.linalg.eigvalsh(prior.covariance[POSITION, POSITION])[-1])
        rotation = float(np.linalg.eigvalsh(prior.covariance[ROTATION, ROTATION])[-1])
        return float(np.sqrt(max(position, 0.0) + self._config.filter.typical_range**2 * max(rotation, 0.0)))

    def _trusted(self, prior: NavState, start: NavState, found: FeatureRegistration) -> bool:
        """Whether enough features match, as many as usual after a vague prediction, and near where they were to."""
        config = self._config.filter
        if found.sums.matches < config.min_matches:
            return False
        share = found.sums.matches / max(found.sums.queries, 1)
        if share < config.vague_share * self._usual_share and not found.converged:
            return False
        jump = float(np.linalg.norm(found.T_odom_body[:3, 3] - start.p_odom))
        return jump < self._config.loam.max_jump + 2.0 * _OPENING_SIGMAS * self._unknown(prior)

    def _learn(self, found: FeatureRegistration) -> None:
        self.noise = self.noise.updated(found, self._config.filter)
        share = found.sums.matches / max(found.sums.queries, 1)
        self._usual_share += _SHARE_GAIN * (share - self._usual_share) if self._usual_share > 0.0 else share


def fused(prior: NavState, found: FeatureRegistration, config: RunConfig) -> FilterUpdate[ScanMeasurement]:
    """Tell the predicted state the pose that was found, with the information that its matches gave.

    Velocity, biases and gravity follow by what the prediction has made them have in common with the pose, eq. (9) of
    docs/theory/loam.md; along what the matches did not see the pose tells nothing.
    """
    information = found.seen.information() / config.loam.correlation
    columns = np.arange(POSE.start, POSE.stop)

    def measure(state: NavState, _: int) -> ScanMeasurement:
        turn = so3.log(found.T_odom_body[:3, :3].T @ state.R_odom_imu)
        error = np.concatenate([turn, state.p_odom - found.T_odom_body[:3, 3]])
        J = np.eye(6)
        J[ROTATION, ROTATION] = np.linalg.inv(so3.right_jacobian(turn))
        return ScanMeasurement(
            columns=columns, information=J.T @ information @ J, gradient=J.T @ information @ error, sums=found.sums
        )

    settings = config.filter
    update = iterated_update(
        prior,
        measure,
        max_iterations=settings.max_iterations,
        tolerance_rotation=settings.tolerance_rotation,
        tolerance_position=settings.tolerance_position,
    )
    return replace(update, iterations=found.iterations, converged=found.converged)


def anchored(state: NavState) -> NavState:
    """Make the pose the odom frame's definition: certain, and unrelated to the other errors."""
    covariance = state.covariance.copy()
    covariance[POSE, :] = 0.0
    covariance[:, POSE] = 0.0
    return replace(state, covariance=covariance)


def _moved(a: ImuPath, b: ImuPath, reach: float) -> float:
    """Return how far two motions of one sweep carry a point at a distance of ``reach`` apart [m]."""

    def way(path: ImuPath) -> tuple[Array, Array]:
        R = path.R_odom_imu[0].T
        return np.asarray(R @ path.R_odom_imu[-1]), np.asarray(R @ (path.p_odom[-1] - path.p_odom[0]))

    (Ra, pa), (Rb, pb) = way(a), way(b)
    return float(np.linalg.norm(pa - pb) + reach * np.linalg.norm(Ra - Rb) / np.sqrt(2.0))
