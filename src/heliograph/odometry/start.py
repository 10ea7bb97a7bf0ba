"""The first second: whether the sensor rests, which way is down, how fast it moves, what the biases are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, NavState, Rig
from heliograph.imu import StaticStart, assess_stillness
from heliograph.imu.white_floor import noise_in_motion
from heliograph.lie import s2, so3
from heliograph.odometry.filter import FilterCore
from heliograph.odometry.motion import MotionModel
from heliograph.odometry.sequencer import Packet

__all__ = ["Start", "find_start"]

Array = NDArray[np.float64]

_UNKNOWN_SPEED, _UNKNOWN_RATE = 5.0, 1.0
_REST_SPEED_SIGMA = 0.02
_MOVING_SPEED_SIGMA, _MOVING_RATE_SIGMA = 0.3, 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where the filter begins and what carries it on."""

    state: NavState
    motion: MotionModel
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Motion:
    """How the LiDAR alone saw the first scans: velocity and rate at their start, and what velocity gained."""

    v_imu: Array
    rate_imu: Array
    v_gained: Array
    mean_rate: Array
    R_first_imu: Array
    stamps_ns: NDArray[np.int64]

    @property
    def speed(self) -> float:
        return float(np.linalg.norm(self.v_imu))


def find_start(packets: Sequence[Packet], imu: ImuBatch, rig: Rig, config: RunConfig, *, threads: int) -> Start:
    """Return the state at the first scan's start.

    The IMU says whether it rests; because a vehicle at constant speed looks just like that, the LiDAR alone is run over
    the same scans and must agree. At rest velocity is zero and the gyroscope shows its bias. In motion velocity and
    rate come from the LiDAR, gravity from the mean force less the velocity gained, with covariances to match.

    Parameters
    ----------
    packets : sequence of Packet
        The first scans, at least one.
    imu : ImuBatch
        All samples up to their end; none selects the constant-velocity model.
    rig : Rig
    config : RunConfig
    threads : int
    """
    moved = _lidar_only(packets, rig, config, threads)
    begin_ns = packets[0].scan.stamp_ns if packets[0].scan is not None else int(imu.stamps_ns[0])
    if len(imu) < 2:
        return _without_imu(begin_ns, packets[0].end_ns, moved, rig, config)
    rest = assess_stillness(imu, config.imu)
    still = rest.still and (moved is None or moved.speed < config.imu.still_speed)
    if still:
        state = _static_state(begin_ns, rest, rig, config)
        motion = MotionModel(config.imu, config.filter, rest.noise)
        events: tuple[Event, ...] = ()
    else:
        state = _moving_state(begin_ns, imu, rest, moved, rig, config)
        motion = MotionModel(config.imu, config.filter, noise_in_motion(imu, config.imu))
        events = (_moving_event(begin_ns, rest, moved),)
    return Start(state=_rebased(state, motion, imu, packets[0].end_ns), motion=motion, events=events)


def _moving_event(begin_ns: int, rest: StaticStart, moved: _Motion | None) -> Event:
    why = rest.reason or f"the LiDAR moves at {moved.speed if moved else 0.0:.2f} m/s although the IMU is calm"
    text = (
        f"the recording starts in motion ({why}); gravity, velocity and biases start from the first second of it, with "
        f"wide uncertainty - begin a recording with 2 s at rest for the best start"
    )
    return Event(code="start-moving", message=text, stamp_ns=begin_ns)


def _blank_state(stamp_ns: int, rig: Rig) -> NavState:
    covariance = np.zeros((17, 17) if rig.known else (23, 23))
    if not rig.known:
        covariance[17:20, 17:20] = rig.sigma_rotation**2 * np.eye(3)
        covariance[20:23, 20:23] = rig.sigma_translation**2 * np.eye(3)
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


def _set_block(state: NavState, first: int, sigma: float) -> None:
    state.covariance[first : first + 3, first : first + 3] = sigma**2 * np.eye(3)


def _constant_velocity_state(
    stamp_ns: int, v: Array, rate: Array, v_sigma: float, rate_sigma: float, rig: Rig
) -> NavState:
    # See MotionModel: the imaginary gyroscope's bias is minus the body rate. The mounting is unobservable without an
    # IMU.
    state = _blank_state(stamp_ns, replace(rig, known=True))
    _set_block(state, 6, v_sigma)
    _set_block(state, 9, rate_sigma)
    return replace(state, v_odom=v, gyro_bias=-rate)


def _without_imu(begin_ns: int, end_ns: int, moved: _Motion | None, rig: Rig, config: RunConfig) -> Start:
    zero = np.zeros(3)
    v, rate = (moved.v_imu, moved.rate_imu) if moved is not None else (zero, zero)
    state = _constant_velocity_state(begin_ns, v, rate, _UNKNOWN_SPEED, _UNKNOWN_RATE, rig)
    text = (
        "no IMU: a constant-velocity model de-skews and predicts; quick motion will smear the map, and up is the "
        "sensor's up at the start - record an IMU, or check --imu-topic"
    )
    event = Event(code="no-imu", message=text, stamp_ns=begin_ns)
    motion = MotionModel(config.imu, config.filter, None)
    empty = ImuBatch(stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)), received_ns=0)
    return Start(state=_rebased(state, motion, empty, end_ns), motion=motion, events=(event,))


def _lidar_only(packets: Sequence[Packet], rig: Rig, config: RunConfig, threads: int) -> _Motion | None:
    """Run the constant-velocity filter over the first scans, and again with its first map de-skewed."""
    scans = [packet.scan for packet in packets if packet.scan is not None and len(packet.scan) > 0]
    if len(scans) < 3:
        return None
    moved: _Motion | None = None
    empty = ImuBatch(stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)), received_ns=0)
    for _ in range(2):
        zero = np.zeros(3)
        v, rate = (moved.v_imu, moved.rate_imu) if moved is not None else (zero, zero)
        state = _constant_velocity_state(scans[0].stamp_ns, v, rate, _UNKNOWN_SPEED, _UNKNOWN_RATE, rig)
        core = FilterCore(state, MotionModel(config.imu, config.filter, None), config, threads=threads)
        results = [core.process(scan, empty) for scan in scans]
        if sum(result.matches > 0 for result in results) < 2:
            return None
        T = np.stack([result.T_odom_imu for result in results])
        stamps = np.array([result.end_ns for result in results], dtype=np.int64)
        moved = _fit_motion(T, stamps, scans[0].stamp_ns)
    return moved


def _fit_motion(T: Array, stamps_ns: NDArray[np.int64], begin_ns: int) -> _Motion:
    """Fit parabolas to positions and rotation vectors, and read them at the first scan's start."""
    t = (stamps_ns - begin_ns) * 1e-9
    degree = 2 if len(t) >= 5 else 1
    turns = so3.log(T[0, :3, :3].T @ T[:, :3, :3])
    position = np.polynomial.polynomial.polyfit(t, T[:, :3, 3], degree)
    rotation = np.polynomial.polynomial.polyfit(t, turns, degree)
    R_first = T[0, :3, :3]
    v_begin = position[1]
    gained = 2.0 * position[2] * (t[-1] - 0.0) if degree == 2 else np.zeros(3)
    return _Motion(
        v_imu=R_first.T @ v_begin,
        rate_imu=rotation[1],
        v_gained=gained,
        mean_rate=(turns[-1] - turns[0]) / (t[-1] - t[0]),
        R_first_imu=T[:, :3, :3],
        stamps_ns=stamps_ns,
    )


def _with_gravity(state: NavState, up_odom: Array, up_sigma: float, config: RunConfig) -> NavState:
    """Return the state with gravity and accelerometer bias from one mean force.

    ``up_odom`` (3,) is the mean of ``R (a - v')`` and equals ``-g + R b`` up to ``up_sigma`` [m/s^2]. One measurement
    cannot tell a tilt from a bias, so the two errors are left as correlated as they are: motion separates them later.
    """
    g = config.imu.gravity
    direction = -up_odom / np.linalg.norm(up_odom)
    prior = np.diag([config.imu.accel_bias_sigma**2] * 3 + [1.0, 1.0])
    H = np.hstack([state.R_odom_imu, -g * s2.basis(direction)])
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + up_sigma**2 * np.eye(3))
    delta = gain @ (up_odom + g * direction)
    posterior = (np.eye(5) - gain @ H) @ prior
    state.covariance[12:17, 12:17] = 0.5 * (posterior + posterior.T)
    return replace(state, accel_bias=delta[:3], g_odom=g * s2.retract(direction, delta[3:]))


def _static_state(begin_ns: int, rest: StaticStart, rig: Rig, config: RunConfig) -> NavState:
    state = replace(
        _blank_state(begin_ns, rig),
        R_odom_imu=so3.from_two_vectors(rest.accel_mean, np.array([0.0, 0.0, 1.0])),
        gyro_bias=rest.gyro_mean,
    )
    count = max(rest.duration / rest.period, 1.0)
    _set_block(state, 6, _REST_SPEED_SIGMA)
    _set_block(state, 9, float(np.hypot(rest.gyro_sigma.max() / np.sqrt(count), 1e-4)))
    up_sigma = float(np.hypot(rest.accel_sigma.max() / np.sqrt(count), 2e-3))
    return _with_gravity(state, state.R_odom_imu @ rest.accel_mean, up_sigma, config)


def _moving_state(
    begin_ns: int, imu: ImuBatch, rest: StaticStart, moved: _Motion | None, rig: Rig, config: RunConfig
) -> NavState:
    up, up_sigma, v, v_sigma = rest.accel_mean, 1.0, np.zeros(3), _UNKNOWN_SPEED
    bias, bias_sigma = np.zeros(3), config.imu.gyro_bias_sigma
    if moved is not None:
        inside = (imu.stamps_ns >= moved.stamps_ns[0]) & (imu.stamps_ns <= moved.stamps_ns[-1])
        if inside.sum() >= 3:
            k = np.clip(np.searchsorted(moved.stamps_ns, imu.stamps_ns[inside]), 0, len(moved.stamps_ns) - 1)
            force = np.einsum("kij,kj->ki", moved.R_first_imu[k], imu.accel[inside]).mean(axis=0)
            span = float(moved.stamps_ns[-1] - moved.stamps_ns[0]) * 1e-9
            up, up_sigma = force - moved.v_gained / span, 0.3
            bias = imu.gyro[inside].mean(axis=0) - moved.mean_rate
            bias_sigma = min(_MOVING_RATE_SIGMA, config.imu.gyro_bias_sigma)
            if np.linalg.norm(bias) > 5.0 * config.imu.gyro_bias_sigma:
                bias, bias_sigma = np.zeros(3), config.imu.gyro_bias_sigma
        v, v_sigma = moved.v_imu, _MOVING_SPEED_SIGMA
    R = so3.from_two_vectors(up, np.array([0.0, 0.0, 1.0]))
    state = replace(_blank_state(begin_ns, rig), R_odom_imu=R, v_odom=R @ v, gyro_bias=bias)
    _set_block(state, 6, v_sigma)
    _set_block(state, 9, bias_sigma)
    return _with_gravity(state, R @ up, up_sigma, config)


def _rebased(state: NavState, motion: MotionModel, imu: ImuBatch, end_ns: int) -> NavState:
    """Move the frame so that the first scan's end is its origin, with x along the body's horizontal heading there."""
    end, _ = motion.predict(state, imu, end_ns)
    forward = end.R_odom_imu[:, 0]
    # A body that points straight up or down has no heading; its second axis then takes the first one's place.
    if np.hypot(forward[0], forward[1]) < 0.1:
        forward = np.cross(end.R_odom_imu[:, 1], np.array([0.0, 0.0, 1.0]))
    R_new_old = so3.exp(np.array([0.0, 0.0, -np.arctan2(forward[1], forward[0])]))
    g_new = R_new_old @ state.g_odom
    covariance = state.covariance.copy()
    magnitude = float(np.linalg.norm(state.g_odom))
    turn = np.eye(len(covariance))
    turn[3:6, 3:6] = turn[6:9, 6:9] = R_new_old
    if magnitude > 0.0:
        turn[15:17, 15:17] = s2.basis(g_new / magnitude).T @ R_new_old @ s2.basis(state.g_odom / magnitude)
    return replace(
        state,
        R_odom_imu=R_new_old @ state.R_odom_imu,
        p_odom=R_new_old @ (state.p_odom - end.p_odom),
        v_odom=R_new_old @ state.v_odom,
        g_odom=g_new,
        covariance=turn @ covariance @ turn.T,
    )
