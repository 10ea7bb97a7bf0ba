"""Tightly coupled iterated error-state Kalman filter on raw points (W. Xu et al., "FAST-LIO2", T-RO 2022)."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import deskew, range_gate
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, NavState, OnlineCalibration, Scan, ScanResult
from heliograph.imu import ImuPath
from heliograph.lie import se3
from heliograph.maps import LocalMap, VoxelMap
from heliograph.odometry.filter.calibration_gate import CalibrationGate
from heliograph.odometry.filter.drift import MapDrift
from heliograph.odometry.filter.matching import AdaptiveNoise, Online, Thinning, is_vague, register
from heliograph.odometry.filter.motion import MotionModel, corrected_path, rate_change, sweep_path
from heliograph.odometry.filter.remounting import anchoring, is_bent, widened
from heliograph.odometry.filter.results import ScanOutcome, Stopwatch, dead_reckoned, scan_result
from heliograph.odometry.filter.update import UpdateResult
from heliograph.registration import NormalEquations

__all__ = ["FilterCore"]

S = TypeVar("S", bound=np.generic)

# A correction smaller than this bends a sweep of 0.1 s by less than a millimetre, so its points need not be moved
# again.
_SAME_SPEED, _SAME_RATE = 0.005, 0.0005
_PRUNE_DISTANCE = 10.0


class FilterCore:
    """The filter proper: a state, a map, and one step a scan.

    Parameters
    ----------
    start : NavState
        At or before the first scan's first point; its frame is made the odom frame.
    motion : MotionModel
        What carries the state from scan to scan.
    config : RunConfig
    local_map : LocalMap or None
        None makes a `VoxelMap`.
    threads : int
        Of the native loops.
    """

    def __init__(
        self,
        start: NavState,
        motion: MotionModel,
        config: RunConfig,
        *,
        local_map: LocalMap | None = None,
        threads: int = 1,
    ) -> None:
        self.state = start
        self.map: LocalMap = local_map if local_map is not None else VoxelMap(config.map)
        self.noise = AdaptiveNoise(config.filter.sigma)
        self._motion, self._config, self._threads = motion, config, threads
        # Points enter the map with the mounting of the start, whatever is learnt of it: a changing one would bend it.
        self._T_imu_lidar = start.T_imu_lidar
        self._gate = CalibrationGate.at_start(start, config.filter)
        self._thinning = Thinning(config.cloud)
        self._usual_share = 0.0
        self._drift = MapDrift(config.filter.systematic)
        self._pruned_at = start.p_odom
        self._history: ImuPath | None = None
        self._anchor: NDArray[np.float64] | None = None
        self._count = self._map_scans = 0

    @property
    def calibration(self) -> OnlineCalibration | None:
        """Mounting and clock as they are believed now, None where they are not estimated under a gate."""
        return None if self._gate is None else self._gate.account(self.state)

    def process(self, scan: Scan, imu: ImuBatch) -> ScanResult:
        """Process one scan; the numbers are those of docs/theory/filter.md."""
        watch = Stopwatch()
        prior, path = self._predict(imu, scan.end_ns)  # (1) state, (2) covariance
        watch.lap("predict")

        keep = range_gate(scan.points, self._config.cloud.min_range, self._config.cloud.max_range)
        points, offsets = _taken(scan.points, keep), _taken(scan.offsets_ns, keep)
        picked = self._thinning.pick(points)
        watch.lap("thin")

        fit = self._match(prior, path, scan, points[picked], offsets[picked])  # (3) to (7)
        posterior = fit.state if fit is not None else _anchored(prior) if len(self.map) == 0 else prior
        if self._gate is not None and fit is not None:
            posterior = self._settled_mounting(posterior)
        sweep, path = sweep_path(path, prior, posterior), corrected_path(path, posterior)  # (8)
        watch.lap("match")

        points_imu = self._deskew(points, offsets, scan, sweep)  # (3), now with the final motion
        watch.lap("deskew")

        if fit is not None or len(self.map) == 0:
            self._extend_map(points_imu, posterior, fit)  # (9)
        watch.lap("map")

        intensity = _taken(scan.intensity, keep) if scan.intensity is not None else None
        outcome = ScanOutcome(scan, posterior, path, points_imu, intensity, fit, len(picked))
        return self._conclude(outcome, watch)

    def _conclude(self, outcome: ScanOutcome, watch: Stopwatch) -> ScanResult:
        """Step to the posterior and give an account of the scan."""
        result = scan_result(
            outcome,
            index=self._count,
            pose_covariance=self._drift.pose_covariance(outcome.state),
            history=self._history,
            timings=watch.laps,
            config=self._config.filter,
        )
        if self._gate is not None:
            result = replace(result, calibration=self._gate.account(outcome.state))
        if outcome.fit is not None:
            self.noise = self.noise.updated(outcome.fit.linearization.rms, self._config.filter)
        self.state, self._history, self._count = outcome.state, outcome.path, self._count + 1
        return result

    def dead_reckon(self, end_ns: int, imu: ImuBatch) -> ScanResult:
        """Carry the state to ``end_ns`` on the motion model alone."""
        watch = Stopwatch()
        self.state, path = self._predict(imu, end_ns)
        watch.lap("predict")
        self._count += 1
        covariance = self._drift.pose_covariance(self.state)
        result = dead_reckoned(
            index=self._count - 1, state=self.state, pose_covariance=covariance, path=path, timings=watch.laps
        )
        return result if self._gate is None else replace(result, calibration=self._gate.account(self.state))

    def _predict(self, imu: ImuBatch, end_ns: int) -> tuple[NavState, ImuPath]:
        if self._gate is not None:
            self._gate = self._gate.predicted(self._motion, self.state, imu, end_ns)
        return self._motion.predict(self.state, imu, end_ns)

    def _online(self, path: ImuPath) -> Online | None:
        """Return what an update must know of the calibration states, None where there are none."""
        if self._gate is None or self._anchor is None:
            return None
        R_first = self._anchor[:3, :3] @ self._T_imu_lidar[:3, :3].T
        return Online(considered=self._gate.considered(), rate_change=rate_change(path), R_first=R_first)

    def _settled_mounting(self, state: NavState) -> NavState:
        """Begin the map anew where a better mounting has shown it to be bent; its first pose defines its frame."""
        assert self._gate is not None
        self._map_scans += 1
        if not (isinstance(self.map, VoxelMap) and is_bent(self._T_imu_lidar, state, self._map_scans)):
            return state
        self._drift.grow(state, 1.0, sigma=self.noise.sigma, matched=True)
        M = anchoring(state)
        state = widened(state, self._T_imu_lidar, self._gate.considered())
        state = replace(state, covariance=M @ state.covariance @ M.T)
        self._gate = self._gate.moved(M)
        self.map, self._anchor, self._map_scans = VoxelMap(self._config.map), None, 0
        self._T_imu_lidar = state.T_imu_lidar
        return state

    def _deskew(
        self, points: NDArray[np.float32], offsets: NDArray[np.int32], scan: Scan, path: ImuPath
    ) -> NDArray[np.float32]:
        first = 0 if self._config.cloud.deskew != "off" else len(path.stamps_ns) - 1
        return deskew(
            points,
            offsets,
            stamp_ns=scan.stamp_ns,
            path_stamps_ns=path.stamps_ns[first:],
            R_odom_body=path.R_odom_imu[first:],
            p_odom=path.p_odom[first:],
            T_body_lidar=self._T_imu_lidar,
            threads=self._threads,
        )

    def _match(
        self, prior: NavState, path: ImuPath, scan: Scan, points: NDArray[np.float32], offsets: NDArray[np.int32]
    ) -> UpdateResult[NormalEquations] | None:
        """Update with the picked points; None when too few of them match."""
        config = self._config.filter
        if len(self.map) == 0 or len(points) < config.min_matches:
            return None
        before_end = ((scan.end_ns - scan.stamp_ns) * 1e-9 - offsets * np.float64(1e-9)).astype(np.float32)

        predicted, online = self._deskew(points, offsets, scan, path), self._online(path)

        def points_at(state: NavState) -> NDArray[np.float32]:
            if _same_sweep(prior, state, path):
                return predicted
            return self._deskew(points, offsets, scan, sweep_path(path, prior, state))

        fit = register(
            prior,
            self.map,
            points_at,
            before_end,
            T_imu_lidar=self._T_imu_lidar,
            noise=self.noise,
            config=config,
            threads=self._threads,
            online=online,
        )
        if not self._trusted(prior, fit, online):
            return None
        if self._gate is not None:
            self._gate = self._gate.updated(fit.linearization)
        return fit

    def _trusted(self, prior: NavState, fit: UpdateResult[NormalEquations], online: Online | None) -> bool:
        """Whether enough points match; after a vague prediction that also means: about as many as before it.

        A scan that was led to a wrong place by a prediction that allowed for one finds planes there too, but fewer.
        """
        config, found = self._config.filter, fit.linearization
        if found.matches < config.min_matches:
            return False
        share = found.matches / found.queries
        if is_vague(prior, self.noise, config, online) and share < config.vague_share * self._usual_share:
            return False
        self._usual_share += 0.1 * (share - self._usual_share) if self._usual_share > 0.0 else share
        return True

    def _map_pose(self, state: NavState) -> NDArray[np.float64]:
        """Return the pose at which the map's points, made with the mounting of the start, fit those already there.

        As the mounting E is believed now, the LiDAR stands at ``T E`` and the map, begun at the pose ``T_0`` with the
        mounting ``E_0``, is displaced by ``T_0 E (T_0 E_0)^-1``.
        """
        if self._anchor is None:
            self._anchor = state.T_odom_imu @ self._T_imu_lidar
        if self._T_imu_lidar is state.T_imu_lidar:
            return state.T_odom_imu
        change = se3.inverse(self._T_imu_lidar) @ state.T_imu_lidar
        displaced = self._anchor @ se3.inverse(change) @ se3.inverse(self._anchor)
        return np.asarray(displaced @ state.T_odom_imu @ state.T_imu_lidar @ se3.inverse(self._T_imu_lidar))

    def _extend_map(
        self, points_imu: NDArray[np.float32], state: NavState, fit: UpdateResult[NormalEquations] | None
    ) -> None:
        """Insert the scan, account for what the map's frame may have drifted by that, and forget what is far away."""
        if isinstance(self.map, VoxelMap):
            share = self.map.insert(points_imu, self._map_pose(state), self._T_imu_lidar)
        else:
            share = self.map.insert(points_imu, state.T_odom_imu)
        self._drift.grow(state, share, sigma=self.noise.sigma, matched=fit is not None)
        if float(np.linalg.norm(state.p_odom - self._pruned_at)) > _PRUNE_DISTANCE:
            self.map.prune(state.p_odom)
            self._pruned_at = state.p_odom


def _same_sweep(prior: NavState, state: NavState, path: ImuPath) -> bool:
    if state.imu_offset != prior.imu_offset:
        later = (state.imu_offset - prior.imu_offset) * rate_change(path)
        if float(np.linalg.norm(later)) >= _SAME_RATE:
            return False
    speed = float(np.linalg.norm(state.R_odom_imu.T @ state.v_odom - prior.R_odom_imu.T @ prior.v_odom))
    rate = float(np.linalg.norm(state.gyro_bias - prior.gyro_bias))
    return speed < _SAME_SPEED and rate < _SAME_RATE


def _taken(values: NDArray[S], keep: NDArray[np.int32]) -> NDArray[S]:
    """Return ``values[keep]``; usually that is all of them."""
    return values if len(keep) == len(values) else values.take(keep, axis=0)


def _anchored(state: NavState) -> NavState:
    """Make the pose the odom frame's definition: certain, and unrelated to the other errors."""
    covariance = state.covariance.copy()
    covariance[:6, :] = 0.0
    covariance[:, :6] = 0.0
    return replace(state, covariance=covariance)
