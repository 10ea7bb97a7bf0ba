"""Tightly coupled iterated error-state Kalman filter on raw points (W. Xu et al., "FAST-LIO2", T-RO 2022)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import deskew, range_gate
from heliograph.config import RunConfig
from heliograph.data import Event, GnssFix, ImuBatch, NavState, Rig, Scan, ScanResult
from heliograph.imu import ImuPath
from heliograph.lie import so3
from heliograph.maps import LocalMap, VoxelMap
from heliograph.odometry.drift import MapDrift
from heliograph.odometry.matching import AdaptiveNoise, Thinning, is_vague, register
from heliograph.odometry.motion import MotionModel, corrected_path, sweep_path
from heliograph.odometry.results import Stopwatch, dead_reckoned, scan_result
from heliograph.odometry.sequencer import Packet, Sequencer
from heliograph.odometry.start import find_start
from heliograph.odometry.update import UpdateResult
from heliograph.registration import NormalEquations

__all__ = ["FilterCore", "FilterOdometry"]

# A correction smaller than this bends a sweep of 0.1 s by less than a millimetre, so its points need not be moved again.
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
        self._thinning = Thinning(config.cloud)
        self._usual_share = 0.0
        self._drift = MapDrift(config.filter.systematic)
        self._pruned_at = start.p_odom
        self._history: ImuPath | None = None
        self._count = 0

    def process(self, scan: Scan, imu: ImuBatch) -> ScanResult:
        """Process one scan; the numbers are those of docs/theory/filter.md."""
        watch, cloud = Stopwatch(), self._config.cloud
        prior, path = self._motion.predict(self.state, imu, scan.end_ns)  # (1) state, (2) covariance
        watch.lap("predict")

        keep = range_gate(scan.points, cloud.min_range, cloud.max_range)
        points, offsets = scan.points[keep], scan.offsets_ns[keep]
        picked = self._thinning.pick(points)
        watch.lap("thin")

        fit = self._match(prior, path, scan, points[picked], offsets[picked])  # (3) to (7)
        posterior = fit.state if fit is not None else prior
        if len(self.map) == 0:
            posterior = _anchored(prior)
        sweep, path = sweep_path(path, prior, posterior), corrected_path(path, posterior)  # (8)
        watch.lap("match")

        points_imu = self._deskew(points, offsets, scan, sweep, posterior)  # (3), now with the final motion
        watch.lap("deskew")
        if fit is not None or len(self.map) == 0:
            share = self._insert(points_imu, posterior)
            self._drift.grow(posterior, share, sigma=self.noise.sigma, matched=fit is not None)  # (9)
            self._prune(posterior)
        watch.lap("map")

        if fit is not None:
            self.noise = self.noise.updated(fit.linearization.rms, self._config.filter)
        self.state = posterior
        result = scan_result(
            index=self._count,
            scan=scan,
            state=posterior,
            pose_covariance=self._drift.pose_covariance(posterior),
            path=path,
            history=self._history,
            points_imu=points_imu,
            intensity=scan.intensity[keep] if scan.intensity is not None else None,
            fit=fit,
            queries=len(picked),
            timings=watch.laps,
            config=self._config.filter,
        )
        self._history, self._count = path, self._count + 1
        return result

    def dead_reckon(self, end_ns: int, imu: ImuBatch) -> ScanResult:
        """Carry the state to ``end_ns`` on the motion model alone."""
        watch = Stopwatch()
        self.state, path = self._motion.predict(self.state, imu, end_ns)
        watch.lap("predict")
        self._count += 1
        covariance = self._drift.pose_covariance(self.state)
        return dead_reckoned(
            index=self._count - 1, state=self.state, pose_covariance=covariance, path=path, timings=watch.laps
        )

    def _deskew(
        self, points: NDArray[np.float32], offsets: NDArray[np.int32], scan: Scan, path: ImuPath, state: NavState
    ) -> NDArray[np.float32]:
        first = 0 if self._config.cloud.deskew != "off" else len(path.stamps_ns) - 1
        return deskew(
            points,
            offsets,
            stamp_ns=scan.stamp_ns,
            path_stamps_ns=path.stamps_ns[first:],
            R_odom_body=path.R_odom_imu[first:],
            p_odom=path.p_odom[first:],
            T_body_lidar=state.T_imu_lidar,
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

        predicted = self._deskew(points, offsets, scan, path, prior)

        def points_at(state: NavState) -> NDArray[np.float32]:
            if _same_sweep(prior, state):
                return predicted
            return self._deskew(points, offsets, scan, sweep_path(path, prior, state), state)

        fit = register(prior, self.map, points_at, before_end, noise=self.noise, config=config, threads=self._threads)
        return fit if self._trusted(prior, fit) else None

    def _trusted(self, prior: NavState, fit: UpdateResult[NormalEquations]) -> bool:
        """Whether enough points match; after a vague prediction that also means: about as many as before it.

        A scan that was led to a wrong place by a prediction that allowed for one finds planes there too, but fewer.
        """
        config, found = self._config.filter, fit.linearization
        if found.matches < config.min_matches:
            return False
        share = found.matches / found.queries
        if is_vague(prior, self.noise, config) and share < config.vague_share * self._usual_share:
            return False
        self._usual_share += 0.1 * (share - self._usual_share) if self._usual_share > 0.0 else share
        return True

    def _insert(self, points_imu: NDArray[np.float32], state: NavState) -> float:
        if isinstance(self.map, VoxelMap):
            return self.map.insert(points_imu, state.T_odom_imu, state.T_imu_lidar)
        return self.map.insert(points_imu, state.T_odom_imu)

    def _prune(self, state: NavState) -> None:
        if float(np.linalg.norm(state.p_odom - self._pruned_at)) > _PRUNE_DISTANCE:
            self.map.prune(state.p_odom)
            self._pruned_at = state.p_odom


def _same_sweep(prior: NavState, state: NavState) -> bool:
    speed = float(np.linalg.norm(state.R_odom_imu.T @ state.v_odom - prior.R_odom_imu.T @ prior.v_odom))
    rate = float(np.linalg.norm(state.gyro_bias - prior.gyro_bias))
    mounting = state.T_imu_lidar is prior.T_imu_lidar or bool(np.array_equal(state.T_imu_lidar, prior.T_imu_lidar))
    return mounting and speed < _SAME_SPEED and rate < _SAME_RATE


def _anchored(state: NavState) -> NavState:
    """Make the pose the odom frame's definition: certain, and unrelated to the other errors."""
    covariance = state.covariance.copy()
    covariance[:6, :] = 0.0
    covariance[:, :6] = 0.0
    return replace(state, covariance=covariance)


class FilterOdometry:
    """The filter as an `Odometry`: it gathers the first second, finds a start, and then steps scan by scan.

    Parameters
    ----------
    config : RunConfig
    rig : Rig
        Mounting; where it is uncertain, it is estimated along.
    sensors : frozenset of str
        ``"lidar"``, ``"imu"`` or both.
    threads : int
    """

    def __init__(
        self,
        config: RunConfig,
        rig: Rig,
        *,
        sensors: frozenset[str],
        threads: int = 1,
        local_map: LocalMap | None = None,
    ) -> None:
        self.events: list[Event] = []
        self.core: FilterCore | None = None
        self._config, self._rig, self._threads, self._local_map = config, rig, threads, local_map
        self._sensors = sensors & {"lidar", "imu"}
        self._sequencer = Sequencer(self._sensors)
        self._waiting: list[Packet] = []

    def add(self, message: Scan | ImuBatch | GnssFix) -> list[ScanResult]:
        """Take one message and return the results that it made ready."""
        return self._advance(self._sequencer.add(message), ended=False)

    def finish(self) -> list[ScanResult]:
        """Return the results still waiting."""
        return self._advance(self._sequencer.finish(), ended=True)

    def leveling(self) -> NDArray[np.float64]:
        """Return ``T_leveled_odom`` (4, 4), the smallest rotation that makes the latest estimate of gravity point down."""
        T = np.eye(4)
        if self.core is not None and np.linalg.norm(self.core.state.g_odom) > 0.0:
            T[:3, :3] = so3.from_two_vectors(self.core.state.g_odom, np.array([0.0, 0.0, -1.0]))
        return T

    def _advance(self, packets: list[Packet], *, ended: bool) -> list[ScanResult]:
        self._waiting += packets
        if self.core is None and not self._start(ended=ended):
            return []
        results = [self._step(packet) for packet in self._waiting]
        self._waiting = []
        self.events += self._sequencer.events
        self._sequencer.events = []
        return results

    def _start(self, *, ended: bool) -> bool:
        if not self._waiting:
            return False
        first = self._waiting[0]
        begin_ns = first.scan.stamp_ns if first.scan is not None else first.end_ns
        if not ended and (self._waiting[-1].end_ns - begin_ns) * 1e-9 < self._config.imu.start_window:
            return False
        imu = self._sequencer.imu.everything()
        start = find_start(self._waiting, imu, self._rig, self._config, threads=self._threads)
        self.events += start.events
        self.core = FilterCore(
            start.state, start.motion, self._config, local_map=self._local_map, threads=self._threads
        )
        return True

    def _step(self, packet: Packet) -> ScanResult:
        assert self.core is not None
        imu = self._sequencer.imu.between(self.core.state.stamp_ns, packet.end_ns)
        if packet.scan is not None:
            result = self.core.process(packet.scan, imu)
        else:
            result = self.core.dead_reckon(packet.end_ns, imu)
        self._sequencer.imu.forget_before(self.core.state.stamp_ns)
        return result
