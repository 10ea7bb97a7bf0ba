"""LiDAR odometry and mapping on edge and planar points (J. Zhang, S. Singh, "LOAM", RSS 2014)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import (
    LINES_NEED,
    LineRule,
    ScanFeatures,
    deskew,
    find_line_rule,
    range_gate,
    scan_features,
    scan_lines,
)
from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, NavState, OnlineCalibration, Scan, ScanResult
from heliograph.data.error_layout import POSITION
from heliograph.imu import ImuPath
from heliograph.maps import FeatureMap, FeaturePoints
from heliograph.odometry.filter.map_keeper import MapKeeper
from heliograph.odometry.filter.motion import MotionModel, corrected_path, sweep_path
from heliograph.odometry.filter.results import ScanOutcome, Stopwatch, dead_reckoned, scan_result
from heliograph.odometry.loam.matching import FeatureMatcher, PoseFit, anchored
from heliograph.odometry.loam.steady import ScanToScan
from heliograph.odometry.loam.sweep import FeatureSweep
from heliograph.snapshots import PART, Stateful

__all__ = ["LoamCore"]


class LoamCore(Stateful):
    """LOAM proper: a state, a map of features, and one step a scan.

    Parameters
    ----------
    start : NavState
        At or before the first scan's first point; its frame is made the odom frame.
    motion : MotionModel
        What carries the state from scan to scan.
    config : RunConfig
    events : list of Event
        Told of how the scan lines are found, and what of a cloud is not used.
    threads : int
        Threads of the native loops; the results do not depend on them.
    """

    _STATE: ClassVar = {
        "state": NavState,
        "map": PART,
        "_motion": PART,
        "_keeper": PART,
        "_matcher": PART,
        "_scan_to_scan": PART,
        "_rule": (LineRule, None),
        "_history": (ImuPath, None),
        "_count": int,
    }

    def __init__(
        self, start: NavState, motion: MotionModel, config: RunConfig, *, events: list[Event], threads: int = 1
    ) -> None:
        self.state, self.map = start, FeatureMap(config.loam, radius=config.map.radius)
        self.calibration: OnlineCalibration | None = None  # mounting and clock are taken as given
        self._motion, self._config, self._events, self._threads = motion, config, events, threads
        self._keeper = MapKeeper(self.map, config.filter, config.map, start.p_odom)
        self._matcher = FeatureMatcher(config, threads=threads)
        self._scan_to_scan = ScanToScan(config, threads=threads)
        self._rule: LineRule | None = None
        self._history: ImuPath | None = None
        self._count = 0

    def process(self, scan: Scan, imu: ImuBatch) -> ScanResult:
        """Process one scan; the numbers are those of docs/theory/loam.md."""
        watch = Stopwatch()
        prior, path = self._predict(imu, scan.end_ns)  # (1) the IMU, or a constant velocity
        watch.lap("predict")

        gated = self._gated(scan)
        features = self._features(gated)  # (2) curvature, (3) what is left out, (4) quotas
        watch.lap("features")

        sweep = FeatureSweep(gated, features, self.state.T_imu_lidar, self._config, self._threads)
        fit = self._match(prior, path, sweep)  # (5) to (8) scan to map, (9) fusion; (11) without an IMU
        posterior = fit.state if fit is not None else anchored(prior) if self._keeper.empty else prior
        final = sweep_path(path, prior, posterior)
        path = corrected_path(path, posterior)
        watch.lap("match")

        points_imu = self._deskew(gated, final)
        watch.lap("deskew")

        posterior = self._extend(sweep.map_points(final), posterior, fit)  # (10)
        watch.lap("map")
        return self._conclude(scan, gated, posterior, path, points_imu, fit, len(features), watch)

    def dead_reckon(self, end_ns: int, imu: ImuBatch) -> ScanResult:
        """Carry the state to ``end_ns`` on the motion model alone."""
        watch = Stopwatch()
        self.state, path = self._predict(imu, end_ns)
        watch.lap("predict")
        self._count += 1
        return dead_reckoned(
            index=self._count - 1,
            state=self.state,
            pose_covariance=self._keeper.pose_covariance(self.state),
            path=path,
            timings=watch.laps,
        )

    def _predict(self, imu: ImuBatch, end_ns: int) -> tuple[NavState, ImuPath]:
        ahead = self._motion.predict(self.state, imu, end_ns)
        self._keeper.predicted(ahead.growth)
        return ahead.state, ahead.path

    def _match(self, prior: NavState, path: ImuPath, sweep: FeatureSweep) -> PoseFit | None:
        if self._motion.inertial:
            return self._matcher.match(prior, path, sweep, self.map)
        fits = (
            self._matcher.match_in_motion(prior, start, path, sweep, self.map)
            for start in self._starts(prior, path, sweep)
        )
        fit = next((fit for fit in fits if fit is not None), None)
        if fit is None:
            return None
        seconds = float(path.stamps_ns[-1] - path.stamps_ns[0]) * 1e-9
        span = float(max(before.max(initial=0.0) for before in sweep.before_end))
        converged = fit.registration.converged
        state = self._motion.settled(prior, fit.state, converged=converged, seconds=seconds, sweep=span)
        return replace(fit, update=replace(fit.update, state=state))

    def _starts(self, prior: NavState, path: ImuPath, sweep: FeatureSweep) -> Iterator[NavState]:
        """Yield where to begin on the map: as predicted, and where the sweep before puts this one."""
        always = self._config.loam.scan_to_scan
        if not always:
            yield prior
        start = self._scan_to_scan.led(prior, path, sweep, self._matcher.opening(prior))
        if always or start is not prior:
            yield start

    def _gated(self, scan: Scan) -> Scan:
        """Return the scan with the points inside the range gate, the very same where all are."""
        keep = range_gate(scan.points, self._config.cloud.min_range, self._config.cloud.max_range)
        return scan if len(keep) == len(scan) else scan.taken(keep)

    def _features(self, scan: Scan) -> ScanFeatures:
        config = self._config.loam.features
        if len(scan) == 0 or (self._rule is None and len(scan) < LINES_NEED):
            none = np.zeros(0, np.int32)
            if len(scan) > 0:
                self._tell(scan, f"{len(scan)} points of a scan tell no lines; LOAM waits for more", code="sparse-scan")
            return ScanFeatures(edges=none, planes=none, map_edges=none, map_planes=none)
        if self._rule is None or (self._rule.kind == "ring" and scan.ring is None):
            self._rule = find_line_rule(scan.points, scan.offsets_ns, scan.ring, config)
            self._tell(scan, f"scan lines are found {self._rule.why}", code="scan-lines")
        lines = scan_lines(scan.points, scan.offsets_ns, scan.ring, self._rule, config)
        if lines.doubles > len(lines.order) // 20:
            text = (
                f"{lines.doubles} points of a scan are nearer returns of a beam that has a farther one; LOAM uses that"
            )
            self._tell(scan, text, code="dual-return")
        return scan_features(scan.points, lines, config, threads=self._threads)

    def _tell(self, scan: Scan, text: str, *, code: str) -> None:
        if all(event.code != code for event in self._events):
            self._events.append(Event(code=code, message=text, stamp_ns=scan.stamp_ns, severity="info"))

    def _extend(self, points: FeaturePoints, posterior: NavState, fit: PoseFit | None) -> NavState:
        """Return the state in the frame of the map with the scan's features in it, where the scan has a place there."""
        if not self._motion.inertial:
            self._scan_to_scan.remember(points, posterior)
        if fit is not None:
            self._keeper.updated(fit.update.retained)
            # Without an IMU, what did not settle ties no new ground to the frame; the next scan that does, ties it.
            tied = fit.seen if fit.update.converged or self._motion.inertial else None
            return self._keeper.extend(points, posterior.T_odom_imu, posterior, tied)
        if self._keeper.empty and len(points) > 0:
            return self._keeper.extend(points, posterior.T_odom_imu, posterior, None)
        return posterior

    def _deskew(self, scan: Scan, path: ImuPath) -> NDArray[np.float32]:
        first = 0 if self._config.cloud.deskew != "off" else len(path.stamps_ns) - 1
        return deskew(
            scan.points,
            scan.offsets_ns,
            stamp_ns=scan.stamp_ns,
            path_stamps_ns=path.stamps_ns[first:],
            R_odom_body=path.R_odom_imu[first:],
            p_odom=path.p_odom[first:],
            T_body_lidar=self.state.T_imu_lidar,
            threads=self._threads,
        )

    def _conclude(
        self,
        scan: Scan,
        gated: Scan,
        state: NavState,
        path: ImuPath,
        points_imu: NDArray[np.float32],
        fit: PoseFit | None,
        queries: int,
        watch: Stopwatch,
    ) -> ScanResult:
        """Step to the posterior and give an account of the scan."""
        outcome = ScanOutcome(
            scan,
            state,
            path,
            points_imu,
            gated.intensity,
            fit.update if fit is not None else None,
            fit.seen if fit is not None else None,
            queries,
        )
        result = scan_result(
            outcome,
            index=self._count,
            pose_covariance=self._keeper.pose_covariance(state),
            history=self._history,
            timings=watch.laps,
            config=self._config.filter,
        )
        self.state, self._history, self._count = state, path, self._count + 1
        return self._judged(result, fit)

    def _judged(self, result: ScanResult, fit: PoseFit | None) -> ScanResult:
        """Return the result with a status that says no more than is known: without an IMU a match is not enough."""
        if self._motion.inertial or fit is None:
            return result
        sigma = float(np.sqrt(np.linalg.eigvalsh(result.pose_covariance[POSITION, POSITION])[-1]))
        if sigma > self._config.filter.lost_sigma:
            return replace(result, status="lost")
        return result if fit.update.converged else replace(result, status="predicted")
