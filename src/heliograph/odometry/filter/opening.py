"""The LiDAR's own account of a recording's first seconds, for a start that cannot wait for rest.

A filter that is led by a loose model follows the body wherever its points say, so that its poses owe little to the
model: constant velocity alone, the gyroscope with constant velocity, or the whole IMU with noise far above its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.config import FilterConfig, RunConfig
from heliograph.data import ImuBatch, ImuNoise, NavState, Rig, Scan, ScanResult, Trajectory
from heliograph.data.error_layout import (
    GYRO_BIAS,
    LEVER_ARM,
    MOUNTED_DIM,
    MOUNTING_ROTATION,
    NAV_DIM,
    POSE,
    POSITION,
    VELOCITY,
)
from heliograph.imu import MotionStart, align_motion
from heliograph.imu.white_floor import noise_in_motion
from heliograph.lie import so3
from heliograph.odometry.filter.core import FilterCore
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.sequencer import Packet

__all__ = [
    "NO_IMU",
    "OpeningMotion",
    "blank_state",
    "find_motion",
    "lidar_only",
    "scans_of",
    "with_block",
    "with_sigma",
]


NO_IMU = ImuBatch(stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)), received_ns=0)

_NO_POINTS = np.zeros((0, 3), np.float32)
# White noise with which the IMU leads the LiDAR: over a scan of 0.1 s a turn of 0.5 deg and 5 cm, well above what a
# match tells, so that the poses stay the LiDAR's.
_LOOSE_GYRO, _LOOSE_ACCEL = 0.03, 3.0
_ALIGNED_SPEED_SIGMA = 0.3  # of a velocity that an alignment has found already [m/s]
_MIN_POSES = 5
# Passes, each de-skewed with what the one before it found, until the velocity stays [m/s], by what is known of it.
_MAX_PASSES = 5
_SETTLED_SPEED = 0.02
_SETTLED_SHARE = 0.3  # of its sigma, that a velocity may change by besides
# Scans to try other speeds with, where the LiDAR is blind along its way and matches less than this share of its points.
_TRIED_SCANS, _BLIND_SHARE = 5, 0.5
_FAST_SPEED = 1.0  # a velocity beyond which a match from rest may be a wrong one [m/s]
# A start looks at the same few seconds again and again, for what a tenth of the points shows: points of a scan that are
# put into its maps, points matched, and one in how many of those without a plane may look for neighbours. The LiDAR
# alone has nothing else to go by, and gets twice as many as where the IMU leads.
_ALONE, _LED = (12_000, 2_000, 2), (6_000, 1_000, 8)
_SCALE_SIGMA = 0.05  # what the scale of an accelerometer may be off


@dataclass(frozen=True, slots=True, kw_only=True)
class OpeningMotion:
    """How the LiDAR alone saw the first scans: velocity and rate at their start, and what velocity gained.

    ``unseen_imu`` (3, 3) is the share of a velocity that they did not see: 0 along what all of them saw, 1 along what
    none did.
    """

    v_imu: Array
    rate_imu: Array
    v_gained: Array
    mean_rate: Array
    R_first_imu: Array
    stamps_ns: NDArray[np.int64]
    unseen_imu: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def speed(self) -> float:
        """[m/s]."""
        return float(np.linalg.norm(self.v_imu))


def scans_of(packets: Sequence[Packet]) -> list[Scan]:
    """Return the scans that hold points, each with as many of them as a start needs."""
    scans = [packet.scan for packet in packets if packet.scan is not None and len(packet.scan) > 0]
    return _thinned(scans, _ALONE[0])


def _thinned(scans: Sequence[Scan], points: int) -> list[Scan]:
    return [scan.thinned(len(scan) // points) if len(scan) >= 2 * points else scan for scan in scans]


def _light(config: RunConfig, matches: int, stride: int) -> RunConfig:
    """Return the configuration with fewer points to match; they lie farther apart, so fewer of them share a plane."""
    matches = min(matches, config.cloud.target_points)
    share = matches / config.cloud.target_points
    return replace(
        config,
        cloud=replace(config.cloud, target_points=matches),
        filter=replace(
            config.filter,
            correlation=max(1.0, share * config.filter.correlation),
            fallback_stride=max(stride, config.filter.fallback_stride) if config.filter.fallback_stride > 0 else 0,
        ),
    )


def blank_state(stamp_ns: int, rig: Rig) -> NavState:
    """Return a state of zeros, known exactly but for the mounting."""
    size = NAV_DIM if rig.known else MOUNTED_DIM
    covariance = np.zeros((size, size))
    if not rig.known:
        covariance[MOUNTING_ROTATION, MOUNTING_ROTATION] = rig.sigma_rotation**2 * np.eye(3)
        covariance[LEVER_ARM, LEVER_ARM] = rig.sigma_translation**2 * np.eye(3)
    return NavState(
        stamp_ns=stamp_ns,
        R_odom_imu=np.eye(3),
        p_odom=np.zeros(3),
        v_odom=np.zeros(3),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        g_odom=np.zeros(3),
        T_imu_lidar=rig.T_imu_lidar.copy(),
        covariance=covariance,
    )


def with_block(state: NavState, block: slice, values: Array) -> NavState:
    """Return the state with other covariances (k, k) of a block of its errors among themselves."""
    covariance = state.covariance.copy()
    covariance[block, block] = values
    return replace(state, covariance=covariance)


def with_sigma(state: NavState, block: slice, sigma: float) -> NavState:
    """Return the state with one sigma for three of its errors, uncorrelated among themselves."""
    return with_block(state, block, sigma**2 * np.eye(3))


def constant_velocity_state(stamp_ns: int, v: Array, rate: Array, rig: Rig, config: FilterConfig) -> NavState:
    """Return the first state of the constant-velocity model, with the sigmas of a motion that nothing tells."""
    # See MotionModel: the imaginary gyroscope's bias is minus the body rate. The mounting is unobservable without an
    # IMU.
    state = blank_state(stamp_ns, replace(rig, known=True))
    state = with_sigma(state, VELOCITY, config.unknown_speed)
    state = with_sigma(state, GYRO_BIAS, config.unknown_rate)
    return replace(state, v_odom=v, gyro_bias=-rate)


def lidar_only(
    packets: Sequence[Packet], rig: Rig, config: RunConfig, threads: int
) -> tuple[OpeningMotion, list[ScanResult]] | None:
    """Run the constant-velocity filter over the first scans, and again with its first map de-skewed.

    Between houses a LiDAR that expects rest sees rest at any speed beyond two metres a scan: the walls along the way
    fit everywhere. What gives that away is that it is blind along the way while most points find nothing; then higher
    speeds are tried, and the one that matches more points is followed.
    """
    scans, config = scans_of(packets), _light(config, *_ALONE[1:])
    if len(scans) < 3:
        return None

    def run(v: Array, rate: Array, count: int) -> tuple[list[ScanResult], list[Array]]:
        state = constant_velocity_state(scans[0].stamp_ns, v, rate, rig, config.filter)
        core = FilterCore(state, MotionModel(config.imu, config.filter, None), config, threads=threads)
        results, blind = [], []
        for scan in scans[:count]:
            results.append(core.process(scan, NO_IMU))
            blind.append(core.blind)
        return results, blind

    zero = np.zeros(3)
    results, blind = run(zero, zero, len(scans))
    if (along := _blind_direction(results, config)) is not None:
        speeds = (0.0, *config.filter.tried_speeds, *(-speed for speed in config.filter.tried_speeds))
        tried = [run(speed * along, zero, _TRIED_SCANS)[0] for speed in speeds]
        best = max(tried, key=_share)
        if best is not tried[0]:
            results, blind = run(best[-1].v_odom, zero, len(scans))
    for last in (False, True):
        if sum(result.matches > 0 for result in results) < 2:
            return None
        T = np.stack([result.T_odom_imu for result in results])
        ends_ns = np.array([result.end_ns for result in results], dtype=np.int64)
        moved = _fit_motion(T, ends_ns, scans[0].stamp_ns, unseen_way(ends_ns, np.stack(blind), 0)[-1])
        if not last:
            results, blind = run(moved.v_imu, moved.rate_imu, len(scans))
    return moved, results


def _share(results: Sequence[ScanResult]) -> float:
    """Return the share of points that matched, the first scan aside."""
    return float(np.mean([result.matches / max(result.queries, 1) for result in results[1:]]))


def _blind_direction(results: Sequence[ScanResult], config: RunConfig) -> Array | None:
    """Return the direction, in the frame of the first pose, that scans are blind in which match few of their points."""
    matched = [result for result in results[1:_TRIED_SCANS] if result.matches > 0]
    if not matched or _share(results[:_TRIED_SCANS]) > _BLIND_SHARE:
        return None
    worst = min(matched, key=lambda result: float(result.eigenvalues_translation[0]))
    if worst.eigenvalues_translation[0] > config.filter.degenerate_translation:
        return None
    return worst.weak_direction


def unseen_way(stamps_ns: NDArray[np.int64], blind: Array, anchor: int) -> Array:
    """Return the derivative of each pose's error, against that of one of them, by a motion that scans did not see.

    Parameters
    ----------
    stamps_ns : (N,) int64
    blind : (N, 6, 6) float64
        Projection of an error onto what each scan did not see of the pose since the one before.
    anchor : int
        Which pose the errors are against.

    Returns
    -------
    (N, 6, 6) float64
        By rate (body) and velocity (frame of the poses) [s].
    """
    seconds = np.diff(stamps_ns, prepend=stamps_ns[:1]) * 1e-9
    gone = np.cumsum(seconds[:, None, None] * blind, axis=0)
    return np.asarray(gone - gone[anchor])


def _fit_motion(T: Array, stamps_ns: NDArray[np.int64], begin_ns: int, unseen: Array) -> OpeningMotion:
    """Fit parabolas to positions and rotation vectors, and read them at the first scan's start."""
    t = (stamps_ns - begin_ns) * 1e-9
    degree = 2 if len(t) >= 5 else 1
    turns = so3.log(T[0, :3, :3].T @ T[:, :3, :3])
    position = np.polynomial.polynomial.polyfit(t, T[:, :3, 3], degree)
    rotation = np.polynomial.polynomial.polyfit(t, turns, degree)
    R_first = T[0, :3, :3]
    v_begin = position[1]
    gained = 2.0 * position[2] * (t[-1] - 0.0) if degree == 2 else np.zeros(3)
    return OpeningMotion(
        v_imu=R_first.T @ v_begin,
        rate_imu=rotation[1],
        v_gained=gained,
        mean_rate=(turns[-1] - turns[0]) / (t[-1] - t[0]),
        R_first_imu=T[:, :3, :3],
        stamps_ns=stamps_ns,
        unseen_imu=R_first.T @ unseen[POSITION, POSITION] @ R_first / (t[-1] - t[0]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Followed:
    """Poses of the scans that matched, with covariances; ``torn`` where scans did not see how some are to others."""

    poses: Trajectory
    covariance: Array
    torn: bool

    def __post_init__(self) -> None:
        freeze(self)


def find_motion(
    packets: Sequence[Packet],
    imu: ImuBatch,
    rig: Rig,
    config: RunConfig,
    *,
    moved: OpeningMotion | None = None,
    threads: int,
) -> tuple[MotionStart, MotionStart] | None:
    """Align the LiDAR's poses of the first scans with the IMU, in passes that de-skew better and better.

    The first pass takes rotation from the gyroscope, because a sensor that is shaken turns too fast for a constant
    rate, and a constant velocity; the others take the whole IMU, with the gravity, velocity and biases of the one
    before. Where everything looks alike along the way, a fast vehicle is followed only from about the right speed: the
    first pass is made from rest and from the speed that the LiDAR alone saw, and that counts which matches more points.

    Parameters
    ----------
    packets, imu, rig, config, threads
        As for `find_start`.
    moved : OpeningMotion, optional
        What `lidar_only` saw of the first of them.

    Returns
    -------
    (MotionStart, MotionStart) or None
        At the first scan's start, with the accelerometer's scale held and with it estimated. None when too few scans
        can be matched to say anything.
    """
    scans = scans_of(packets)
    # Sparse scans cost little as they are, and need what they have.
    dense = max((len(scan) for scan in scans), default=0) >= 2 * _LED[0]
    scans, light = (_thinned(scans, _LED[0]), _light(config, *_LED[1:])) if dense else (scans, config)
    if len(scans) < _MIN_POSES or not _of_one_time(scans, imu):
        return None
    noise = noise_in_motion(imu, config.imu)

    def led(state: NavState, lead: ImuBatch) -> _Led:
        return _Led(state, lead, light, threads)

    def align(followed: _Followed, scale_sigma: float = 0.0) -> MotionStart:
        return align_motion(
            followed.poses,
            followed.covariance,
            imu,
            noise=noise,
            config=config.imu,
            begin_ns=scans[0].stamp_ns,
            scale_sigma=scale_sigma,
            speed_change=config.filter.unknown_speed if followed.torn else np.inf,
        )

    tried = [led(*lead).follow(scans[:_TRIED_SCANS]) for lead in _led_by_gyro(scans[0], imu, rig, moved, config.filter)]
    followed = max(tried, key=lambda one: one.share).follow(scans[_TRIED_SCANS:]).poses()
    found: MotionStart | None = None
    for _ in range(_MAX_PASSES):
        if followed is None:
            return None
        before, found = found, align(followed)
        if found.verdict == "failed" or (before is not None and _same_velocity(before, found)):
            break
        followed = led(*_led_by_imu(scans[0], found, imu, rig)).follow(scans).poses()
    return (found, align(followed, _SCALE_SIGMA)) if found is not None and followed is not None else None


def _of_one_time(scans: Sequence[Scan], imu: ImuBatch) -> bool:
    """Tell whether there are samples of the scans' time; where the clocks differ there may be none."""
    meanwhile = (imu.stamps_ns >= scans[0].stamp_ns) & (imu.stamps_ns <= scans[-1].end_ns)
    return int(np.count_nonzero(meanwhile)) >= len(scans)


def _same_velocity(before: MotionStart, after: MotionStart) -> bool:
    changed = after.R_odom_imu[0].T @ after.v_odom[0] - before.R_odom_imu[0].T @ before.v_odom[0]
    unknown = after.R_odom_imu[0].T @ after.velocity_covariance[0] @ after.R_odom_imu[0]
    allowed = _SETTLED_SPEED**2 * np.eye(3) + _SETTLED_SHARE**2 * unknown
    return bool(changed @ np.linalg.solve(allowed, changed) < 1.0)


def _led_by_gyro(
    first: Scan, imu: ImuBatch, rig: Rig, moved: OpeningMotion | None, config: FilterConfig
) -> Iterator[tuple[NavState, ImuBatch]]:
    """Yield states and samples for the real gyroscope beside an accelerometer that reads zero without gravity."""
    state, lead = blank_state(first.stamp_ns, replace(rig, known=True)), replace(imu, accel=np.zeros_like(imu.accel))
    state = with_sigma(state, VELOCITY, config.unknown_speed)
    yield state, lead
    if moved is not None and moved.speed > _FAST_SPEED:
        yield replace(state, v_odom=moved.v_imu), lead


def _led_by_imu(first: Scan, found: MotionStart, imu: ImuBatch, rig: Rig) -> tuple[NavState, ImuBatch]:
    state = blank_state(first.stamp_ns, replace(rig, known=True))
    state = with_block(state, VELOCITY, _ALIGNED_SPEED_SIGMA**2 * np.eye(3) + found.velocity_covariance[0])
    return replace(
        state,
        R_odom_imu=found.R_odom_imu[0],
        v_odom=found.v_odom[0],
        gyro_bias=found.gyro_bias,
        accel_bias=found.accel_bias,
        g_odom=found.g_odom,
    ), imu


class _Led:
    """A filter over scans that the samples only lead.

    Parameters
    ----------
    state : NavState
        At the first scan's start.
    imu : ImuBatch
    config : RunConfig
    threads : int
    """

    def __init__(self, state: NavState, imu: ImuBatch, config: RunConfig, threads: int) -> None:
        noise = ImuNoise(gyro=_LOOSE_GYRO, accel=_LOOSE_ACCEL, gyro_walk=0.0, accel_walk=0.0)
        self._core = FilterCore(state, MotionModel(config.imu, config.filter, noise), config, threads=threads)
        self._imu, self._config = imu, config.filter
        self._results: list[ScanResult] = []
        self._blind: list[Array] = []

    @property
    def share(self) -> float:
        """Share of the points that matched."""
        return _share(self._results)

    def follow(self, scans: Sequence[Scan]) -> _Led:
        """Go on over more scans; return itself."""
        for scan in scans:
            self._results.append(replace(self._core.process(scan, self._imu), points_imu=_NO_POINTS))
            self._blind.append(self._core.blind)
        return self

    def poses(self) -> _Followed | None:
        """Return the poses of the scans that matched, None where they are too few to say anything."""
        kept = [k for k, result in enumerate(self._results) if result.matched]
        if len(kept) < _MIN_POSES:
            return None
        results = [self._results[k] for k in kept]
        stamps_ns = np.array([result.end_ns for result in results], dtype=np.int64)
        unseen = self._unseen(stamps_ns, np.stack([self._blind[k] for k in kept]))
        return _Followed(
            poses=Trajectory(stamps_ns=stamps_ns, T_frame_body=np.stack([result.T_odom_imu for result in results])),
            covariance=np.stack([result.covariance[POSE, POSE] for result in results]) + unseen,
            torn=bool(unseen.any()),
        )

    def _unseen(self, stamps_ns: NDArray[np.int64], blind: Array) -> Array:
        """Return what a motion adds to the poses' covariance, (N, 6, 6), that scans between them did not see.

        It is told against the longest stretch of poses that are tied to each other. As one unknown velocity moves all
        the others together, and they will be taken for independent, each has that much less to say.
        """
        cut = np.abs(blind).max(axis=(1, 2)) > 0.0
        runs = np.cumsum(cut)
        anchor = int(np.argmax(runs == np.bincount(runs).argmax()))
        by_motion = unseen_way(stamps_ns, blind, anchor)
        apart = max(int(np.count_nonzero(np.abs(by_motion).max(axis=(1, 2)) > 0.0)), 1)
        sigma = np.repeat([self._config.unknown_rate, self._config.unknown_speed], 3)
        return np.asarray(apart * (by_motion * sigma**2) @ np.swapaxes(by_motion, 1, 2))
