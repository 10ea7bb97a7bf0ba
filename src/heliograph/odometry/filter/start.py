"""Where the filter begins: at rest or in motion, which way is down, how fast, with what biases, and how well known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array
from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, NavState, Rig, StartAccount
from heliograph.data.error_layout import (
    ACCEL_BIAS,
    BIASES,
    GRAVITY,
    GYRO_BIAS,
    NAV,
    NAV_DIM,
    POSITION,
    ROTATION,
    VELOCITY,
)
from heliograph.imu import MotionStart, StaticStart, assess_stillness
from heliograph.imu.white_floor import noise_in_motion
from heliograph.lie import s2, so3
from heliograph.odometry.filter.motion import MotionModel
from heliograph.odometry.filter.opening import (
    NO_IMU,
    OpeningMotion,
    blank_state,
    constant_velocity_state,
    find_motion,
    lidar_only,
    scans_of,
    with_block,
    with_sigma,
)
from heliograph.odometry.filter.rest import rest_explains
from heliograph.odometry.sequencer import Packet

__all__ = ["FilterStart", "FirstLook", "find_start", "look"]


_REST_SPEED_SIGMA = 0.02  # [m/s]
_REST_RATE_FLOOR, _REST_UP_FLOOR = 1e-4, 2e-3  # added to what rest shows of bias and force [rad/s], [m/s^2]
_MOVING_SPEED_SIGMA, _MOVING_RATE_SIGMA, _MOVING_UP_SIGMA = 0.3, 0.02, 0.3  # [m/s], [rad/s], [m/s^2]
_UNKNOWN_UP_SIGMA = 1.0  # of a mean force in motion that no LiDAR has corrected [m/s^2]
_IMPLAUSIBLE_BIAS_SIGMAS = 5.0  # a gyroscope bias beyond this multiple of its prior is a match gone wrong
_SCALE_TOLERANCE, _SCALE_SIGMAS = 0.02, 4.0  # error of an accelerometer's scale that is worth a warning
_HEADING_MIN = 0.1  # horizontal part of the body's x axis below which it has no heading
# The filter matches the scans of the start again, from the first one on. It begins with a quarter of the information
# that the alignment drew from them, so that they count little more than once.
_INFORMATION_SHARE = 0.25
_FREE = slice(VELOCITY.start, NAV_DIM)  # the errors of a start, whose pose defines its frame
_LEANING = slice(ACCEL_BIAS.start, GRAVITY.stop)  # accelerometer bias and gravity, which one force cannot tell apart


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterStart:
    """Where the filter begins, what carries it on, and the account of how well that is known."""

    state: NavState
    motion: MotionModel
    events: tuple[Event, ...]
    account: StartAccount


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstLook:
    """What the first second shows, and whether more of the recording would tell more.

    Parameters
    ----------
    rest : StaticStart or None
        None without an IMU.
    moved : OpeningMotion or None
        None where too few scans could be matched.
    still : bool
        Whether IMU and LiDAR agree that nothing moves.
    scans : int
        Number of scans with points.
    """

    rest: StaticStart | None
    moved: OpeningMotion | None
    still: bool
    scans: int

    @property
    def wants_more(self) -> bool:
        """Whether it moves, and LiDAR and IMU are both there to tell how."""
        return self.rest is not None and not self.still and self.scans > 0


def look(packets: Sequence[Packet], imu: ImuBatch, rig: Rig, config: RunConfig, *, threads: int) -> FirstLook:
    """Judge from the first packets whether the recording begins at rest.

    The IMU says whether it rests; because a vehicle at constant speed looks just like that, and a slow steady turn like
    a bias, the LiDAR alone is run over the same scans and must agree. An IMU that vibrates, on an idling engine, or
    shows a very large bias, needs that consent. Where nothing faces a direction the LiDAR alone slides along it: a
    motion that explains the scans no better than rest does not contradict a calm IMU.
    """
    alone, scans = lidar_only(packets, rig, config, threads), scans_of(packets)
    moved = alone[0] if alone is not None else None
    if len(imu) < 2:
        return FirstLook(rest=None, moved=moved, still=False, scans=len(scans))
    rest = assess_stillness(imu, config.imu)
    agreed = not rest.doubtful
    if rest.still and alone is not None:
        # A steady turn that looks like a very large bias is no calm: that takes a LiDAR that sees rest.
        agreed = _lidar_rests(alone[0], config) or (not rest.biased and rest_explains(scans, alone[1], config))
    return FirstLook(rest=rest, moved=moved, still=rest.still and agreed, scans=len(scans))


def _lidar_rests(moved: OpeningMotion, config: RunConfig) -> bool:
    return moved.speed < config.imu.still_speed and float(np.linalg.norm(moved.mean_rate)) < config.imu.still_turn


def find_start(
    packets: Sequence[Packet],
    imu: ImuBatch,
    rig: Rig,
    config: RunConfig,
    *,
    threads: int,
    first: FirstLook | None = None,
) -> FilterStart:
    """Return the state at the first scan's start.

    At rest velocity is zero and the gyroscope shows its bias. In motion the LiDAR's poses and the IMU are aligned; what
    they leave open together, such as a tilt and an accelerometer bias, stays correlated in the covariance.

    Parameters
    ----------
    packets : sequence of Packet
        The first scans, at least one.
    imu : ImuBatch
        All samples up to their end; none selects the constant-velocity model.
    rig : Rig
    config : RunConfig
    threads : int
    first : FirstLook, optional
        What `look` said of the first of these packets; of all of them if not given.
    """
    first = first or look(packets, imu, rig, config, threads=threads)
    begin_ns = _begin_of(packets, imu)
    if first.rest is None:
        return _without_imu(begin_ns, packets[0].end_ns, first.moved, rig, config)
    if first.still:
        state = _static_state(begin_ns, first.rest, rig, config)
        motion = MotionModel(config.imu, config.filter, first.rest.noise)
        account = _static_account(first.rest, state)
        events: tuple[Event, ...] = ()
    else:
        motion = MotionModel(config.imu, config.filter, noise_in_motion(imu, config.imu))
        state, account = _moving_start(packets, imu, rig, config, first, threads)
        events = (_moving_event(begin_ns, first, account), *_scale_event(begin_ns, account))
    state = _rebased(state, motion, imu, packets[0].end_ns)
    return FilterStart(state=state, motion=motion, events=events, account=account)


def _moving_start(
    packets: Sequence[Packet], imu: ImuBatch, rig: Rig, config: RunConfig, first: FirstLook, threads: int
) -> tuple[NavState, StartAccount]:
    """Return the aligned state, or a wide one from the mean force where nothing could be aligned."""
    assert first.rest is not None
    found = find_motion(packets, imu, rig, config, moved=first.moved, threads=threads)
    if found is not None and found[0].verdict != "failed":
        return _aligned_state(found[0], rig, config), _moving_account(*found)
    state = _rough_state(_begin_of(packets, imu), imu, first.rest, first.moved, rig, config)
    why = found[0].reason if found is not None else "too few scans could be matched"
    return state, _account(state, kind="moving", verdict="poor", reason=why, duration=first.rest.duration)


def _begin_of(packets: Sequence[Packet], imu: ImuBatch) -> int:
    return packets[0].scan.stamp_ns if packets[0].scan is not None else int(imu.stamps_ns[0])


def _account(state: NavState, *, kind: str, verdict: str, reason: str, duration: float) -> StartAccount:
    """Return the account of a start with the sigmas of its state."""
    sigma = np.sqrt(np.diag(state.covariance))
    return StartAccount(
        kind=kind,
        verdict=verdict,
        reason=reason,
        duration=duration,
        gravity_sigma=float(np.sqrt(np.linalg.eigvalsh(state.covariance[GRAVITY, GRAVITY])[-1])),
        velocity_sigma=float(np.sqrt(np.linalg.eigvalsh(state.covariance[VELOCITY, VELOCITY])[-1])),
        gyro_bias_sigma=sigma[GYRO_BIAS],
        accel_bias_sigma=sigma[ACCEL_BIAS],
    )


def _static_account(rest: StaticStart, state: NavState) -> StartAccount:
    account = _account(state, kind="static", verdict=rest.grade, reason=rest.remark, duration=rest.duration)
    return replace(account, stillness=rest.statistic)


def _moving_account(found: MotionStart, scaled: MotionStart) -> StartAccount:
    excitation = found.excitation
    observed = "accelerometer scale" not in scaled.unobservable
    return StartAccount(
        kind="moving",
        verdict=found.verdict,
        reason=found.reason,
        duration=excitation.duration,
        gravity_sigma=found.gravity_sigma,
        velocity_sigma=found.velocity_sigma,
        gyro_bias_sigma=found.gyro_bias_sigma,
        accel_bias_sigma=found.accel_bias_sigma,
        accel_scale=scaled.accel_scale if observed else 1.0,
        accel_scale_sigma=scaled.accel_scale_sigma,
        turned=excitation.turned,
        rate_rms=excitation.rate_rms,
        force_rms=excitation.force_rms,
        misfit=found.misfit,
        unobservable=found.unobservable,
    )


def _moving_event(begin_ns: int, first: FirstLook, account: StartAccount) -> Event:
    speed = first.moved.speed if first.moved else 0.0
    turn = float(np.linalg.norm(first.moved.mean_rate)) if first.moved else 0.0
    moves = f"the LiDAR moves at {speed:.2f} m/s and turns at {turn:.2g} rad/s although the IMU is calm"
    why = (first.rest.reason if first.rest else "") or moves
    text = (
        f"the recording starts in motion ({why}); gravity, velocity and biases come from its first "
        f"{account.duration:.1f} s, verdict {account.verdict}: {account.reason}"
    )
    if account.unobservable:
        text += f"; not observed: {', '.join(account.unobservable)}"
    usable = account.verdict in ("good", "fair")
    if not usable:
        text += " - begin a recording with 2 s at rest for a sure start"
    return Event(code="start-moving", message=text, stamp_ns=begin_ns, severity="info" if usable else "warning")


def _scale_event(begin_ns: int, account: StartAccount) -> tuple[Event, ...]:
    off, sigma = abs(account.accel_scale - 1.0), account.accel_scale_sigma
    if not off > _SCALE_TOLERANCE + _SCALE_SIGMAS * sigma:
        return ()
    text = (
        f"the accelerometer shows {account.accel_scale:.3f} (+- {sigma:.3f}) times the motion that the LiDAR saw and "
        f"gravity: check its unit and calibration, or set input.accel_unit"
    )
    return (Event(code="accel-scale", message=text, stamp_ns=begin_ns),)


def _without_imu(begin_ns: int, end_ns: int, moved: OpeningMotion | None, rig: Rig, config: RunConfig) -> FilterStart:
    zero = np.zeros(3)
    v, rate = (moved.v_imu, moved.rate_imu) if moved is not None else (zero, zero)
    state = constant_velocity_state(begin_ns, v, rate, rig, config.filter)
    text = (
        "no IMU: a constant-velocity model de-skews and predicts; quick motion will smear the map, and up is the "
        "sensor's up at the start - record an IMU, or check --imu-topic"
    )
    event = Event(code="no-imu", message=text, stamp_ns=begin_ns)
    motion = MotionModel(config.imu, config.filter, None)
    account = StartAccount(kind="no-imu", verdict="fair" if moved is not None else "poor", reason="no IMU")
    state = _rebased(state, motion, NO_IMU, end_ns)
    return FilterStart(state=state, motion=motion, events=(event,), account=account)


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
    bias_and_tilt = gain @ (up_odom + g * direction)
    posterior = (np.eye(5) - gain @ H) @ prior
    state = with_block(state, _LEANING, 0.5 * (posterior + posterior.T))
    return replace(state, accel_bias=bias_and_tilt[:3], g_odom=g * s2.retract(direction, bias_and_tilt[3:]))


def _static_state(begin_ns: int, rest: StaticStart, rig: Rig, config: RunConfig) -> NavState:
    state = replace(
        blank_state(begin_ns, rig),
        R_odom_imu=so3.from_two_vectors(rest.accel_mean, np.array([0.0, 0.0, 1.0])),
        gyro_bias=rest.gyro_mean,
    )
    sigma = np.sqrt(np.diag(rest.covariance))
    state = with_sigma(state, VELOCITY, _REST_SPEED_SIGMA)
    state = with_sigma(state, GYRO_BIAS, float(np.hypot(sigma[:3].max(), _REST_RATE_FLOOR)))
    up_sigma = float(np.hypot(sigma[3:].max(), _REST_UP_FLOOR))
    return _with_gravity(state, state.R_odom_imu @ rest.accel_mean, up_sigma, config)


def _aligned_state(found: MotionStart, rig: Rig, config: RunConfig) -> NavState:
    """Return the filter's state, level and at the origin, from an alignment whose frame is the LiDAR's first.

    The pose becomes exact by definition: it is where the frame is attached. What was uncertain about it before goes
    over to velocity and gravity, eq. (12) of docs/theory/initialisation.md.
    """
    R0, g = found.R_odom_imu[0], float(np.linalg.norm(found.g_odom))
    v_imu, down_imu = R0.T @ found.v_odom[0], R0.T @ found.g_odom / g
    R = so3.from_two_vectors(-down_imu, np.array([0.0, 0.0, 1.0]))
    down = R @ down_imu
    state = replace(
        blank_state(int(found.stamps_ns[0]), rig),
        R_odom_imu=R,
        v_odom=R @ v_imu,
        gyro_bias=found.gyro_bias,
        accel_bias=found.accel_bias,
        g_odom=g * down,
    )
    if not rig.known:
        # An alignment with a mounting that is still a guess is as wrong as the guess: only its mean is used.
        state = with_sigma(state, VELOCITY, _MOVING_SPEED_SIGMA)
        state = with_sigma(state, GYRO_BIAS, min(_MOVING_RATE_SIGMA, config.imu.gyro_bias_sigma))
        return _with_gravity(state, -g * down + R @ found.accel_bias, _MOVING_UP_SIGMA, config)
    J = np.zeros((NAV_DIM, NAV_DIM))
    J[VELOCITY, ROTATION], J[VELOCITY, VELOCITY] = R @ so3.hat(v_imu), R @ R0.T
    J[BIASES, BIASES] = np.eye(6)
    tangent = s2.basis(down).T @ R
    J[GRAVITY, ROTATION] = tangent @ so3.hat(down_imu)
    J[GRAVITY, GRAVITY] = tangent @ R0.T @ s2.basis(found.g_odom / g)
    covariance = J[_FREE] @ _covariance_for_filter(found, config) @ J[_FREE].T
    return with_block(state, _FREE, 0.5 * (covariance + covariance.T))


def _covariance_for_filter(found: MotionStart, config: RunConfig) -> Array:
    """Return the covariance (17, 17) that the filter begins with: the priors, and a share of what the scans showed."""
    information = _INFORMATION_SHARE * found.information[NAV, NAV]
    prior = np.repeat([config.imu.gyro_bias_sigma**-2, config.imu.accel_bias_sigma**-2], 3)
    information[BIASES, BIASES] += np.diag(prior)
    return np.asarray(np.linalg.inv(information))


def _rough_state(
    begin_ns: int, imu: ImuBatch, rest: StaticStart, moved: OpeningMotion | None, rig: Rig, config: RunConfig
) -> NavState:
    up, up_sigma, v, v_sigma = rest.accel_mean, _UNKNOWN_UP_SIGMA, np.zeros(3), config.filter.unknown_speed
    bias, bias_sigma = np.zeros(3), config.imu.gyro_bias_sigma
    if moved is not None:
        inside = (imu.stamps_ns >= moved.stamps_ns[0]) & (imu.stamps_ns <= moved.stamps_ns[-1])
        if inside.sum() >= 3:
            k = np.clip(np.searchsorted(moved.stamps_ns, imu.stamps_ns[inside]), 0, len(moved.stamps_ns) - 1)
            force = np.einsum("kij,kj->ki", moved.R_first_imu[k], imu.accel[inside]).mean(axis=0)
            span = float(moved.stamps_ns[-1] - moved.stamps_ns[0]) * 1e-9
            up, up_sigma = force - moved.v_gained / span, _MOVING_UP_SIGMA
            bias = imu.gyro[inside].mean(axis=0) - moved.mean_rate
            bias_sigma = min(_MOVING_RATE_SIGMA, config.imu.gyro_bias_sigma)
            if np.linalg.norm(bias) > _IMPLAUSIBLE_BIAS_SIGMAS * config.imu.gyro_bias_sigma:
                bias, bias_sigma = np.zeros(3), config.imu.gyro_bias_sigma
        v, v_sigma = moved.v_imu, _MOVING_SPEED_SIGMA
    R = so3.from_two_vectors(up, np.array([0.0, 0.0, 1.0]))
    state = replace(blank_state(begin_ns, rig), R_odom_imu=R, v_odom=R @ v, gyro_bias=bias)
    unseen = R @ moved.unseen_imu if moved is not None else np.zeros((3, 3))
    state = with_block(state, VELOCITY, v_sigma**2 * np.eye(3) + config.filter.unknown_speed**2 * unseen @ unseen.T)
    state = with_sigma(state, GYRO_BIAS, bias_sigma)
    return _with_gravity(state, R @ up, up_sigma, config)


def _rebased(state: NavState, motion: MotionModel, imu: ImuBatch, end_ns: int) -> NavState:
    """Move the frame so that the first scan's end is its origin, with x along the body's horizontal heading there."""
    end = motion.predict(state, imu, end_ns).state
    forward = end.R_odom_imu[:, 0]
    # A body that points straight up or down has no heading; its second axis then takes the first one's place.
    if np.hypot(forward[0], forward[1]) < _HEADING_MIN:
        forward = np.cross(end.R_odom_imu[:, 1], np.array([0.0, 0.0, 1.0]))
    R_new_old = so3.exp(np.array([0.0, 0.0, -np.arctan2(forward[1], forward[0])]))
    g_new = R_new_old @ state.g_odom
    covariance = state.covariance.copy()
    magnitude = float(np.linalg.norm(state.g_odom))
    turn = np.eye(len(covariance))
    turn[POSITION, POSITION] = turn[VELOCITY, VELOCITY] = R_new_old
    if magnitude > 0.0:
        turn[GRAVITY, GRAVITY] = s2.basis(g_new / magnitude).T @ R_new_old @ s2.basis(state.g_odom / magnitude)
    return replace(
        state,
        R_odom_imu=R_new_old @ state.R_odom_imu,
        p_odom=R_new_old @ (state.p_odom - end.p_odom),
        v_odom=R_new_old @ state.v_odom,
        g_odom=g_new,
        covariance=turn @ covariance @ turn.T,
    )
