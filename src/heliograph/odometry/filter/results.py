"""The account that the filter gives of each scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.config import FilterConfig
from heliograph.data import Event, NavState, Scan, ScanResult, ScanStatus, Trajectory
from heliograph.data.error_layout import POSE, POSITION
from heliograph.imu import ImuPath
from heliograph.lie import interpolate_se3, se3
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.update import FilterUpdate
from heliograph.registration import TrueShare, observability

__all__ = ["ScanOutcome", "Stopwatch", "dead_reckoned", "scan_result"]


class Stopwatch:
    """Milliseconds a stage."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = perf_counter()

    def lap(self, name: str) -> None:
        """Book the time since the last lap under ``name``."""
        now = perf_counter()
        self.laps[name] = 1e3 * (now - self._last)
        self._last = now


@dataclass(frozen=True, slots=True)
class ScanOutcome:
    """What processing a scan led to."""

    scan: Scan
    state: NavState
    path: ImuPath
    points_imu: NDArray[np.float32]
    intensity: NDArray[np.float32] | None
    fit: FilterUpdate[ScanMeasurement] | None
    seen: TrueShare | None
    queries: int

    def __post_init__(self) -> None:
        freeze(self)


def scan_result(
    outcome: ScanOutcome,
    *,
    index: int,
    pose_covariance: NDArray[np.float64],
    history: ImuPath | None,
    timings: dict[str, float],
    config: FilterConfig,
) -> ScanResult:
    """Put together the record of one scan; `history` is the path before this one, for stamps that reach back."""
    scan, path, points_imu, fit = outcome.scan, outcome.path, outcome.points_imu, outcome.fit
    common = replace(
        _base(index, outcome.state, pose_covariance, _trajectory(path), timings),
        stamp_ns=scan.stamp_ns,
        header_stamp_ns=scan.header_stamp_ns,
        T_odom_imu_header=_pose_at(_joined(history, path), scan.header_stamp_ns),
        points_imu=points_imu,
        intensity=outcome.intensity,
        queries=outcome.queries,
        events=(*_held_events(path, scan), *_innovation_events(fit, scan), *_unsteady_events(fit, scan)),
    )
    if fit is None or outcome.seen is None:
        return replace(common, status=_status_without_match(outcome, index, pose_covariance, config))
    equations = fit.measurement.sums
    mean_square = float(np.einsum("ij,ij->", points_imu, points_imu)) / max(len(points_imu), 1)
    found = observability(equations, mean_square)
    return replace(
        common,
        status="tracked" if outcome.seen.share.all() else "degenerate",
        weak_share=float(outcome.seen.share.min()),
        matches=equations.matches,
        fallback_matches=equations.fallback_matches,
        iterations=fit.iterations,
        rms=equations.rms,
        nis=fit.nis,
        eigenvalues_rotation=found.rotation,
        eigenvalues_translation=found.translation,
        weak_direction=found.weak_direction,
        lidar_information=fit.measurement.information[POSE, POSE],
    )


def dead_reckoned(
    *, index: int, state: NavState, pose_covariance: NDArray[np.float64], path: ImuPath, timings: dict[str, float]
) -> ScanResult:
    """Put together the record of an instant without a scan."""
    return _base(index, state, pose_covariance, _trajectory(path), timings)


def _base(
    index: int,
    state: NavState,
    pose_covariance: NDArray[np.float64],
    trajectory: Trajectory,
    timings: dict[str, float],
) -> ScanResult:
    return ScanResult(
        index=index,
        stamp_ns=int(trajectory.stamps_ns[0]),
        header_stamp_ns=state.stamp_ns,
        end_ns=state.stamp_ns,
        T_odom_imu=state.T_odom_imu,
        v_odom=state.v_odom,
        gyro_bias=state.gyro_bias,
        accel_bias=state.accel_bias,
        g_odom=state.g_odom,
        T_imu_lidar=state.T_imu_lidar,
        covariance=state.covariance,
        pose_covariance=pose_covariance,
        path=trajectory,
        T_odom_imu_header=state.T_odom_imu,
        points_imu=np.zeros((0, 3), np.float32),
        intensity=None,
        status="predicted",
        timings=timings,
    )


def _status_without_match(
    outcome: ScanOutcome, index: int, pose_covariance: NDArray[np.float64], config: FilterConfig
) -> ScanStatus:
    if index == 0:
        return "first"
    if float(np.sqrt(np.linalg.eigvalsh(pose_covariance[POSITION, POSITION])[-1])) > config.lost_sigma:
        return "lost"
    return "empty" if len(outcome.points_imu) == 0 else "predicted"


def _held_events(path: ImuPath, scan: Scan) -> tuple[Event, ...]:
    if path.held_s <= 0.0:
        return ()
    text = (
        f"no IMU samples for {path.held_s:.3f} s before a scan's end; the last rate and force were held and the "
        f"covariance grew"
    )
    return (Event(code="imu-held", message=text, stamp_ns=scan.stamp_ns),)


def _innovation_events(fit: FilterUpdate[ScanMeasurement] | None, scan: Scan) -> tuple[Event, ...]:
    if fit is None or fit.excess <= 1.0:
        return ()
    text = (
        f"a scan's match moves the pose otherwise than the IMU allows (squared correction {fit.nis:.0f} times its "
        f"variance, 6 is usual; {fit.excess:.1f} times what chance explains) and weighs so much less: look for a "
        f"place that looks like another, a crowd, a shock, or an IMU that is off"
    )
    return (Event(code="match-against-imu", message=text, stamp_ns=scan.stamp_ns),)


def _unsteady_events(fit: FilterUpdate[ScanMeasurement] | None, scan: Scan) -> tuple[Event, ...]:
    if fit is None or fit.bend is None or not fit.bend.beyond_model:
        return ()
    text = (
        f"the motion within a sweep changes by more than one velocity and one rate explain: beginning and end lie "
        f"{fit.bend.shift:.2f} m apart from where they should, {fit.bend.forgiven:.2f} m are forgiven; without an IMU "
        f"its pose is known no better - record one, or turn the LiDAR faster"
    )
    return (Event(code="unsteady-sweep", message=text, stamp_ns=scan.stamp_ns),)


def _trajectory(path: ImuPath) -> Trajectory:
    T = se3.from_rotation_translation(path.R_odom_imu, path.p_odom)
    return Trajectory(stamps_ns=path.stamps_ns, T_frame_body=T, frame="odom", body="imu")


def _joined(history: ImuPath | None, path: ImuPath) -> Trajectory:
    if history is None:
        return _trajectory(path)
    whole = replace(
        path,
        stamps_ns=np.concatenate([history.stamps_ns[:-1], path.stamps_ns]),
        R_odom_imu=np.concatenate([history.R_odom_imu[:-1], path.R_odom_imu]),
        p_odom=np.concatenate([history.p_odom[:-1], path.p_odom]),
        v_odom=np.concatenate([history.v_odom[:-1], path.v_odom]),
    )
    return _trajectory(whole)


def _pose_at(trajectory: Trajectory, stamp_ns: int) -> NDArray[np.float64]:
    """Return the pose at a stamp; just outside the trajectory its end's twist is carried on."""
    T = interpolate_se3(trajectory.stamps_ns, trajectory.T_frame_body, np.array([stamp_ns]), extrapolate=True)
    return np.asarray(T[0])
