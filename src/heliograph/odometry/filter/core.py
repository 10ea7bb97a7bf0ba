"""Tightly coupled iterated error-state Kalman filter on raw points (W. Xu et al., "FAST-LIO2", T-RO 2022)."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.cloud import deskew, range_gate
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, NavState, OnlineCalibration, Scan, ScanResult
from heliograph.data.error_layout import POSE, POSE_DIM
from heliograph.imu import ImuPath
from heliograph.maps import LocalMap, VoxelMap
from heliograph.odometry.filter.bending import CLOUD_BENT
from heliograph.odometry.filter.calibrating import CalibrationTerms, FixedCalibration, calibration_of
from heliograph.odometry.filter.drift import MapDrift
from heliograph.odometry.filter.map_keeper import MapKeeper
from heliograph.odometry.filter.matching import AdaptiveNoise, ScanMatcher, sweep_noise
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.motion import MotionModel, corrected_path, rate_change, sweep_path
from heliograph.odometry.filter.relocking import Relocker
from heliograph.odometry.filter.results import ScanOutcome, Stopwatch, dead_reckoned, scan_result
from heliograph.odometry.filter.update import FilterUpdate
from heliograph.odometry.filter.wheels import SpeedTrust, SpeedUpdates
from heliograph.snapshots import PART, Snapshot, Stateful

__all__ = ["CoreMark", "FilterCore"]

S = TypeVar("S", bound=np.generic)


@dataclass(frozen=True, slots=True)
class CoreMark:
    """Where a filter is, but for its map: state, path of the last sweep, scans processed, and what the keepers know."""

    state: NavState
    history: ImuPath | None
    count: int
    drift: MapDrift
    calibration: FixedCalibration
    relocker: Relocker
    speeds: SpeedTrust


# A correction smaller than this bends a sweep of 0.1 s by less than a millimetre, so its points need not be moved
# again [m/s], [rad/s].
_SAME_SPEED, _SAME_RATE = 0.005, 0.0005


class FilterCore(Stateful):
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
    speeds : SpeedUpdates, optional
        What wheels or legs measure; the state then has their scale.
    threads : int
        Threads of the native loops; the results do not depend on them.
    """

    _STATE: ClassVar = {
        "state": NavState,
        "map": PART,
        "_motion": PART,
        "_calibration": PART,
        "_keeper": PART,
        "_matcher": PART,
        "_relocker": PART,
        "speeds": PART,
        "_history": (ImuPath, None),
        "_count": int,
        "_begins_anew": bool,
    }

    def __init__(
        self,
        start: NavState,
        motion: MotionModel,
        config: RunConfig,
        *,
        local_map: LocalMap | None = None,
        speeds: SpeedUpdates | None = None,
        threads: int = 1,
    ) -> None:
        self.state = start
        self._motion, self._config, self._threads = motion, config, threads
        self._calibration = calibration_of(start, config.filter)
        self.map: LocalMap = local_map if local_map is not None else VoxelMap(config.map)
        """What scans are matched to."""
        self._keeper = MapKeeper(self.map, config.filter, config.map, start.p_odom)
        self._matcher = ScanMatcher(config, threads=threads)
        self._deskews = config.cloud.deskew != "off"
        self._history: ImuPath | None = None
        self._sweep_noise: Array | None = None
        self._count = 0
        self._relocker = Relocker()
        self.speeds = speeds if speeds is not None else SpeedUpdates(config.wheels)
        """What wheels or legs say."""
        self._begins_anew = False
        self.blind = np.zeros((POSE_DIM, POSE_DIM))
        """Projection of an error of the pose onto what the last scan did not see of it."""
        self.blindfolded = self.holds_map = False
        """Whether scans are matched to nothing, and whether those that are matched leave the map as it is."""

    def snapshot(self) -> Snapshot:
        """Return what the next scans depend on."""
        return {**super().snapshot(), "unmoved": self._calibration.T_imu_lidar is self.state.T_imu_lidar}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another filter that was made alike."""
        unmoved = snapshot.get("unmoved")
        super().restore({name: value for name, value in snapshot.items() if name != "unmoved"})
        if unmoved is True:  # a mounting that is the very same needs no correction, one that is merely equal gets one
            self._calibration.T_imu_lidar = self.state.T_imu_lidar

    @property
    def noise(self) -> AdaptiveNoise:
        """Range noise across planes, as past scans show it."""
        return self._matcher.noise

    @property
    def calibration(self) -> OnlineCalibration | None:
        """Mounting and clock as they are estimated now, None where they are not estimated under a gate."""
        return self._calibration.account(self.state)

    @property
    def usual_share(self) -> float:
        """Share of the points that usually match."""
        return self._matcher.usual_share

    @property
    def seeking(self) -> bool:
        """Whether the scans since the last match have found no place yet and are being sought."""
        return self._relocker.seeking

    def mark(self) -> CoreMark:
        """Return what `come_back` needs to return to here, the map apart."""
        kept = copy(self._keeper.drift), copy(self._calibration), copy(self._relocker)
        return CoreMark(self.state, self._history, self._count, *kept, self.speeds.trust)

    def come_back(self, mark: CoreMark) -> None:
        """Come back to a mark, on the map as it is."""
        self.state, self._history, self._count = mark.state, mark.history, mark.count
        self._keeper.drift, self._calibration = copy(mark.drift), copy(mark.calibration)
        self._relocker, self.speeds.trust = copy(mark.relocker), mark.speeds

    def begin_anew(self, mark: CoreMark, imu: ImuBatch, begin_ns: int, end_ns: int) -> None:
        """Come back to a mark and begin a new map with the next scan, whose sweep begins at ``begin_ns``.

        The samples up to ``end_ns`` tell which way is up, which the silence before may have lost.
        """
        self.come_back(mark)
        self.map.clear()
        self.state, self._begins_anew = self._motion.levelled(mark.state, imu, begin_ns, end_ns), True

    def step_back(self, imu: ImuBatch, begin_ns: int, count: int) -> None:
        """Carry the state back to where the sweep of scan ``count`` began, which had no place when it came."""
        self.state, back = self._motion.carried_back(self.state, imu, begin_ns)
        self._keeper.updated(back)
        self._history, self._count = None, count

    def process(self, scan: Scan, imu: ImuBatch) -> ScanResult:
        """Process one scan; the numbers are those of docs/theory/filter.md."""
        watch = Stopwatch()
        prior, path = self._predict(imu, scan.end_ns)  # (1) state, (2) covariance
        watch.lap("predict")

        keep = range_gate(scan.points, self._config.cloud.min_range, self._config.cloud.max_range)
        points, offsets = _taken(scan.points, keep), _taken(scan.offsets_ns, keep)
        picked = self._matcher.thinning.pick(points)
        watch.lap("thin")

        fit = self._match(prior, path, scan, points[picked], offsets[picked])  # (3) to (7)
        sought = self.seeking
        if self._begins_anew:
            self._relocker.begin(prior.stamp_ns)
        if self._begins_anew or self._relocker.told(prior, fit):
            prior, self._begins_anew = self._keeper.begin_anew(prior), False
        posterior = self._settled(fit.state) if fit is not None else _anchored(prior) if self._keeper.empty else prior
        if sought and fit is not None:  # the way there was lost; that through the sweep is known from its end
            sweep = path = self._motion.way_back(posterior, imu, scan.stamp_ns)
        else:
            sweep, path = sweep_path(path, prior, posterior), corrected_path(path, posterior)  # (8)
        watch.lap("match")

        points_imu = self._deskew(points, offsets, scan, sweep)  # (3), now with the final motion
        watch.lap("deskew")

        seen = fit.measurement.pose_share() if fit is not None else None
        self.blind = seen.blind() if seen is not None else np.zeros((POSE_DIM, POSE_DIM))
        # A scan that was found again after a silence waits for others to bear it out: it enters no map.
        if self._keeper.empty or (fit is not None and not (sought or self.holds_map)):
            pose = self._calibration.map_pose(posterior, first=self._keeper.empty)
            matched = self._matcher.matched(points_imu, picked, posterior, self.map) if seen is not None else None
            converged = fit is None or fit.converged
            posterior = self._motion.loosened(posterior, prior, CLOUD_BENT, converged=converged)
            posterior = self._keeper.extend(points_imu, pose, posterior, seen, matched)  # (9)
            posterior = self._motion.loosened(posterior, prior, 1.0 - CLOUD_BENT, converged=converged)
        watch.lap("map")

        if fit is not None or self._count == 0:
            self._relocker.remember(points_imu, posterior.T_odom_imu)

        intensity = _taken(scan.intensity, keep) if scan.intensity is not None else None
        return self._conclude(ScanOutcome(scan, posterior, path, points_imu, intensity, fit, seen, len(picked)), watch)

    def dead_reckon(self, end_ns: int, imu: ImuBatch) -> ScanResult:
        """Carry the state to ``end_ns`` on the motion model alone."""
        watch = Stopwatch()
        self.state, path = self._predict(imu, end_ns)
        watch.lap("predict")
        self._count += 1
        result = dead_reckoned(
            index=self._count - 1,
            state=self.state,
            pose_covariance=self._keeper.pose_covariance(self.state),
            path=path,
            timings=watch.laps,
        )
        return replace(result, calibration=self.calibration, events=self.speeds.taken_events())

    def _predict(self, imu: ImuBatch, end_ns: int) -> tuple[NavState, ImuPath]:
        ahead = self._motion.predict(self.state, imu, end_ns)
        self._calibration.grow(ahead.growth)
        self._keeper.predicted(ahead.growth)
        self._sweep_noise = sweep_noise(ahead.growth) if self._motion.inertial else None
        considered = self._calibration.terms(ahead.path).considered
        told = self.speeds.updated(ahead.state, ahead.path, considered, sees=not self.blind.any())
        if told is None:
            return ahead.state, ahead.path
        self._keeper.updated(told.retained)
        return told.state, sweep_path(ahead.path, ahead.state, told.state)

    def _match(
        self, prior: NavState, path: ImuPath, scan: Scan, points: NDArray[np.float32], offsets: NDArray[np.int32]
    ) -> FilterUpdate[ScanMeasurement] | None:
        """Update with the picked points; None when too few of them match."""
        if self._keeper.empty or self.blindfolded or len(points) < self._config.filter.min_matches:
            return None
        before_end = self._before_end(scan, offsets)
        predicted, terms = self._deskew(points, offsets, scan, path), self._calibration.terms(path)

        def points_at(state: NavState) -> NDArray[np.float32]:
            if _same_sweep(prior, state, path):
                return predicted
            return self._deskew(points, offsets, scan, sweep_path(path, prior, state))

        astray = self._matcher.usual_share > 0.0 and self._relocker.astray(prior, terms.map_pose_covariance(prior))
        fit = None
        if not astray or self.holds_map:
            fit = self._matcher.match(prior, self.map, points_at, before_end, terms, self._sweep_noise)
        # Scans that only bear out a place that was found are not sought themselves: each search looks over a whole
        # region, and all that wait would be sought again with every scan that comes.
        if fit is None and not self.holds_map:
            fit = self._place_again(prior, predicted, points_at, before_end, terms)
        if fit is None:
            return None
        self._calibration.learn(fit.measurement)
        self._keeper.updated(fit.retained)
        seconds = float(path.stamps_ns[-1] - path.stamps_ns[0]) * 1e-9
        bend = None
        if not self._motion.inertial:
            bend = self._matcher.bend(points_at(fit.state), before_end, fit.state, self.map)
        self._motion.learn(prior, fit.state, seconds=seconds, bend=bend)
        return replace(fit, bend=bend)

    def _place_again(
        self,
        prior: NavState,
        predicted: NDArray[np.float32],
        points_at: Callable[[NavState], NDArray[np.float32]],
        before_end: NDArray[np.float32],
        terms: CalibrationTerms,
    ) -> FilterUpdate[ScanMeasurement] | None:
        """Look for the scan widely where the prediction has become vague, every few scans; else return None."""

        def attempt(state: NavState) -> FilterUpdate[ScanMeasurement]:
            return self._matcher.registered(state, self.map, points_at, before_end, terms, self._sweep_noise)

        covariance = terms.map_pose_covariance(prior)
        return self._relocker.sought(prior, covariance, self.map, predicted, attempt, self._matcher.usual_share)

    def _before_end(self, scan: Scan, offsets: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return how long before the sweep's end each point was carried over by velocity and rate, (N,) [s]."""
        if not self._deskews:
            return np.zeros(len(offsets), np.float32)  # nothing is, so a residual tells nothing about either
        before_end = (scan.end_ns - scan.stamp_ns) * 1e-9 - offsets * np.float64(1e-9)
        return np.asarray(before_end, dtype=np.float32)

    def _settled(self, state: NavState) -> NavState:
        """Begin the map anew where a better mounting has shown it to be bent; its first pose defines its frame."""
        if not self._calibration.is_bent(state, self._keeper.scans):
            return state
        self._keeper.begin_anew(state)
        return self._calibration.remounted(state)

    def _deskew(
        self, points: NDArray[np.float32], offsets: NDArray[np.int32], scan: Scan, path: ImuPath
    ) -> NDArray[np.float32]:
        first = 0 if self._deskews else len(path.stamps_ns) - 1
        return deskew(
            points,
            offsets,
            stamp_ns=scan.stamp_ns,
            path_stamps_ns=path.stamps_ns[first:],
            R_odom_body=path.R_odom_imu[first:],
            p_odom=path.p_odom[first:],
            T_body_lidar=self._calibration.T_imu_lidar,
            threads=self._threads,
        )

    def _conclude(self, outcome: ScanOutcome, watch: Stopwatch) -> ScanResult:
        """Step to the posterior and give an account of the scan."""
        result = scan_result(
            outcome,
            index=self._count,
            pose_covariance=self._keeper.pose_covariance(outcome.state),
            history=self._history,
            timings=watch.laps,
            config=self._config.filter,
        )
        if outcome.fit is not None:
            self._matcher.noise = self.noise.updated(outcome.fit.measurement.sums.rms, self._config.filter)
        self.state, self._history, self._count = outcome.state, outcome.path, self._count + 1
        events = (*self._relocker.taken_events(), *self.speeds.taken_events())
        return replace(result, calibration=self.calibration, events=(*result.events, *events))


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
    covariance[POSE, :] = 0.0
    covariance[:, POSE] = 0.0
    return replace(state, covariance=covariance)
