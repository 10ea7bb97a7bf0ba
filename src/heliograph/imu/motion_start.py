"""Gravity, velocities and biases of a body that never rested, from a few seconds of LiDAR poses and IMU.

In three steps (T. Qin, S. Shen, "Robust initialization of monocular visual-inertial estimation on aerial robots", IROS
2017; A. Martinelli, "Closed-form solution of visual-inertial structure from motion", IJCV 2014, with the scale known):
the gyroscope's bias from turns, then velocity, gravity and accelerometer bias in closed form, then all of it together
with the poses, weighted by what each is known to. Equation numbers are those of docs/theory/initialisation.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise, Trajectory
from heliograph.data.error_layout import ACCEL_BIAS, GYRO_BIAS
from heliograph.errors import DataError
from heliograph.imu.motion_chain import LOG_SCALE, NODE, SHARED, Chain, ChainStep, relax
from heliograph.imu.preintegration import Preintegration, preintegrate
from heliograph.lie import s2, se3, so3

__all__ = ["ImuExcitation", "MotionStart", "align_motion"]


_MAX_ITERATIONS = 30
_SETTLED_STEP = 1e-5  # largest step of any unknown at which the iteration has converged [rad], [m], [m/s] ...
_SETTLED_COST = 0.01  # ... or change of the cost, in squared sigmas: along what nothing observes it goes on for long
_LEAST_SHARE = 0.05  # shortest part of a step that is tried
# Poses count as known no better than this, so that one that is exact by definition can be weighed against others.
_MIN_ROTATION_SIGMA, _MIN_POSITION_SIGMA = 1e-5, 1e-4
_UNOBSERVED_SHARE = 0.7  # a bias whose sigma the data left above this share of its prior was not observed
_GOOD_TILT, _FAIR_TILT = np.radians(0.5), np.radians(2.0)
_GOOD_SPEED, _FAIR_SPEED = 0.1, 0.5  # [m/s]
# Squared error in units of its variance, on average, from which poses and IMU contradict each other.
_STRAINED_MISFIT, _CONTRADICTORY_MISFIT = 4.0, 25.0
_HELD_SCALE_SIGMA = 1e-6  # sigma of the logarithm of a scale that is not asked for
_AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuExcitation:
    """What the body did while it was watched.

    Parameters
    ----------
    duration : float
        [s].
    poses : int
        Instants with a pose.
    turned : float
        Largest rotation between any pose and the first [rad].
    rate_rms, force_rms : (3,) float64
        Root mean square of rate and of specific force about its mean, imu axes [rad/s], [m/s^2].
    """

    duration: float
    poses: int
    turned: float
    rate_rms: Array
    force_rms: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionStart:
    """The motion found, and how well.

    Parameters
    ----------
    stamps_ns : (K,) int64
        The instant asked for, if any, and those of the poses [ns].
    R_odom_imu : (K, 3, 3) float64
    p_odom, v_odom : (K, 3) float64
        Position [m], velocity [m/s].
    velocity_covariance : (K, 3, 3) float64
        [m^2/s^2].
    gyro_bias, accel_bias : (3,) float64
        [rad/s], [m/s^2].
    accel_scale : float
        What the accelerometer shows for each m/s^2; 1 where it was not asked for.
    g_odom : (3,) float64
        Gravity [m/s^2].
    covariance : (18, 18) float64
        Covariance at the first instant: rotation (body), position, velocity (odom), gyro bias, accelerometer bias,
        gravity direction on S(2), logarithm of the scale.
    information : (18, 18) float64
        Information of the data without the priors on biases and scale.
    excitation : ImuExcitation
    misfit : float
        Squared error in units of its variance, on average over the degrees of freedom; about 1 when noise and
        covariances are what they claim to be.
    iterations : int
    verdict : str
        ``"good"``, ``"fair"``, ``"poor"`` (usable, but hardly better than a guess) or ``"failed"``.
    reason : str
        Numbers behind the verdict.
    unobservable : tuple of str
        What the motion did not tell; it stays at its prior.
    """

    stamps_ns: NDArray[np.int64]
    R_odom_imu: Array
    p_odom: Array
    v_odom: Array
    velocity_covariance: Array
    gyro_bias: Array
    accel_bias: Array
    accel_scale: float
    g_odom: Array
    covariance: Array
    information: Array
    excitation: ImuExcitation
    misfit: float
    iterations: int
    verdict: str
    reason: str
    unobservable: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def gravity_sigma(self) -> float:
        """Sigma of the direction of gravity seen from the body, in its worst direction [rad]."""
        return float(
            np.sqrt(np.linalg.eigvalsh(_tilt_covariance(self.R_odom_imu[0], self.g_odom, self.covariance))[-1])
        )

    @property
    def velocity_sigma(self) -> float:
        """Sigma of the first velocity in its worst direction [m/s]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.velocity_covariance[0])[-1]))

    @property
    def gyro_bias_sigma(self) -> Array:
        """[rad/s], (3,)."""
        return np.sqrt(np.diag(self.covariance)[GYRO_BIAS])

    @property
    def accel_bias_sigma(self) -> Array:
        """[m/s^2], (3,)."""
        return np.sqrt(np.diag(self.covariance)[ACCEL_BIAS])

    @property
    def accel_scale_sigma(self) -> float:
        """Sigma of the scale; its prior's where it was not observed."""
        return float(self.accel_scale * np.sqrt(self.covariance[LOG_SCALE, LOG_SCALE]))


def align_motion(
    poses: Trajectory,
    pose_covariance: Array,
    imu: ImuBatch,
    *,
    noise: ImuNoise,
    config: ImuConfig,
    T_imu_lidar: Array | None = None,
    begin_ns: int | None = None,
    scale_sigma: float = 0.0,
    speed_change: float = np.inf,
) -> MotionStart:
    """Find gravity, velocities and biases from poses of a LiDAR's own odometry and the IMU beside them.

    Parameters
    ----------
    poses : Trajectory
        At least three, strictly increasing in time; of the imu, or of the lidar (``poses.body == "lidar"``).
    pose_covariance : (N, 6, 6) float64
        Rotation (body), position (``poses.frame``) of each; errors of different poses are taken to be independent.
    imu : ImuBatch
        Samples over the same time.
    noise : ImuNoise
    config : ImuConfig
        Length of gravity, priors of the biases, limits of the integration.
    T_imu_lidar : (4, 4) float64, optional
        Mounting; needed for poses of the lidar.
    begin_ns : int, optional
        An instant before the first pose at which the state is wanted too [ns].
    scale_sigma : float
        Prior of the logarithm of the accelerometer's scale; 0 holds it at one.
    speed_change : float
        One-sigma of what the velocity may have changed by meanwhile, where poses do not tell it along some direction:
        the mean force points up but for that [m/s].

    Returns
    -------
    MotionStart
        Also where the motion tells little: the verdict says so and names what was not observed.

    Raises
    ------
    DataError
        Fewer than three poses or two samples, stamps that do not increase, or poses of the lidar without a mounting.
    """
    _check(poses, pose_covariance, imu, T_imu_lidar)
    stamps, measured = _measurements(poses, pose_covariance, T_imu_lidar, begin_ns)
    lean = speed_change / (config.gravity * max(float(stamps[-1] - stamps[0]) * 1e-9, 1e-3))
    sigmas = np.repeat([config.gyro_bias_sigma, config.accel_bias_sigma, lean, scale_sigma], [3, 3, 2, 1])

    def between(gyro_bias: Array, accel_bias: Array) -> Preintegration:
        return preintegrate(
            imu, stamps[:-1], stamps[1:], noise=noise, config=config, gyro_bias=gyro_bias, accel_bias=accel_bias
        )

    bias, deltas = _gyro_bias(measured, between, config)
    chain = _closed_form(stamps, measured, deltas, bias, config)
    down = _down_by_force(chain, deltas)
    if np.isfinite(lean):
        chain = replace(chain, g=config.gravity * down)
    chain, solution, iterations, settled = _settled(chain, measured, between, sigmas, down)
    freedom = 6 * len(poses) + int(np.isfinite(sigmas).sum()) - NODE - SHARED
    found = MotionStart(
        stamps_ns=stamps,
        R_odom_imu=chain.R,
        p_odom=chain.p,
        v_odom=chain.v,
        velocity_covariance=solution.velocity_covariance,
        gyro_bias=chain.gyro_bias,
        accel_bias=chain.accel_bias,
        accel_scale=float(np.exp(chain.log_scale)),
        g_odom=chain.g,
        covariance=solution.covariance,
        information=solution.information,
        excitation=_excitation(stamps, chain, imu, poses),
        misfit=solution.cost / max(freedom, 1),
        iterations=iterations,
        verdict="",
        reason="",
        unobservable=_unobserved(solution, sigmas),
    )
    return _judged(found, settled=settled)


def _settled(
    chain: Chain,
    measured: tuple[Array, Array, Array],
    between: Callable[[Array, Array], Preintegration],
    sigmas: Array,
    down: Array,
) -> tuple[Chain, ChainStep, int, bool]:
    """Repeat Gauss-Newton steps, each on motion integrated anew with the biases found, until they are negligible."""
    # A scale that is held has the narrowest of priors: the same algebra serves both.
    weight = np.where(np.isfinite(sigmas), np.maximum(sigmas, _HELD_SCALE_SIGMA) ** -2.0, 0.0)

    def step_from(chain: Chain) -> ChainStep:
        deltas = between(chain.gyro_bias, chain.accel_bias)
        # Tangent vectors from here to the prior's direction: minus the deviation from it.
        lean = -s2.local(chain.g / np.linalg.norm(chain.g), down) if np.isfinite(sigmas[6]) else np.zeros(2)
        off = np.concatenate([chain.gyro_bias, chain.accel_bias, lean, [chain.log_scale]])
        return relax(chain, deltas, measured, (off, weight))

    solution, share = step_from(chain), 1.0
    for iteration in range(1, _MAX_ITERATIONS + 1):
        moved = chain.moved(share * solution.nodes, share * solution.shared)
        if solution.largest < _SETTLED_STEP:
            return moved, solution, iteration, True
        ahead = step_from(moved)
        gain = solution.cost - ahead.cost
        if gain < -_SETTLED_COST and share > _LEAST_SHARE:
            share *= 0.5  # gravity has a fixed length: where nothing else holds a tilt, a straight step overshoots
            continue
        chain, solution, share = moved, ahead, min(1.0, 2.0 * share)
        if abs(gain) < _SETTLED_COST:
            return chain, solution, iteration, True
    return chain, solution, _MAX_ITERATIONS, False


def _check(poses: Trajectory, pose_covariance: Array, imu: ImuBatch, T_imu_lidar: Array | None) -> None:
    if len(poses) < 3:
        raise DataError(f"{len(poses)} poses; at least 3 are needed to find a motion's gravity and velocity")
    if int(np.diff(poses.stamps_ns).min()) <= 0:
        raise DataError("two poses have the same stamp; leave one of them out")
    if pose_covariance.shape != (len(poses), 6, 6):
        raise DataError(
            f"covariances of shape {pose_covariance.shape} for {len(poses)} poses; give ({len(poses)}, 6, 6)"
        )
    if len(imu) < 2:
        raise DataError(f"{len(imu)} IMU samples; at least 2 are needed")
    if poses.body == "lidar" and T_imu_lidar is None:
        raise DataError("poses of the lidar need the mounting T_imu_lidar to become poses of the imu")


def _measurements(
    poses: Trajectory, covariance: Array, T_imu_lidar: Array | None, begin_ns: int | None
) -> tuple[NDArray[np.int64], tuple[Array, Array, Array]]:
    """Return stamps, and rotations, positions and informations of the imu at them, eq. (1) and (2)."""
    T, P = poses.T_frame_body, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    if poses.body == "lidar" and T_imu_lidar is not None:
        T_lidar_imu = se3.inverse(T_imu_lidar)
        # A turn of the lidar swings the imu at the end of the lever arm.
        J = np.tile(np.eye(6), (len(T), 1, 1))
        J[:, 0:3, 0:3] = T_lidar_imu[:3, :3].T
        J[:, 3:6, 0:3] = -T[:, :3, :3] @ so3.hat(T_lidar_imu[:3, 3])
        T, P = T @ T_lidar_imu, J @ P @ np.swapaxes(J, -1, -2)
    least = np.repeat([_MIN_ROTATION_SIGMA**2, _MIN_POSITION_SIGMA**2], 3)
    information: Array = np.asarray(np.linalg.inv(P + np.diag(least)), dtype=np.float64)
    stamps, R, p = poses.stamps_ns, T[:, :3, :3], T[:, :3, 3]
    if begin_ns is not None and begin_ns < stamps[0]:
        stamps = np.concatenate([[np.int64(begin_ns)], stamps])
        R, p = np.concatenate([R[:1], R]), np.concatenate([p[:1], p])
        information = np.concatenate([np.zeros((1, 6, 6)), information])
    return stamps, (R, p, information)


def _first_seen(information: Array) -> int:
    """Return the number of the first instant with a measured pose."""
    return int(np.nonzero(information[:, 0, 0] > 0.0)[0][0])


def _gyro_bias(
    measured: tuple[Array, Array, Array], between: Callable[[Array, Array], Preintegration], config: ImuConfig
) -> tuple[Array, Preintegration]:
    """Return the bias with which the gyroscope turns as the poses do, eq. (4), and the motion with it."""
    R, _, information = measured
    first, bias, prior = _first_seen(information), np.zeros(3), config.gyro_bias_sigma**-2.0
    for _ in range(3):
        deltas = between(bias, np.zeros(3))
        turns = np.swapaxes(R[first:-1], -1, -2) @ R[first + 1 :]
        residual = so3.log(np.swapaxes(deltas.delta_R[first:], -1, -2) @ turns)
        J = deltas.bias_jacobian[first:, 0:3, 0:3]
        # Both ends of a turn err.
        weight = float(np.mean(np.trace(information[first:, :3, :3], axis1=1, axis2=2))) / 6.0
        H = weight * np.einsum("kji,kjl->il", J, J) + prior * np.eye(3)
        bias = bias + np.linalg.solve(H, weight * np.einsum("kji,kj->i", J, residual) - prior * bias)
    return bias, between(bias, np.zeros(3))


def _closed_form(
    stamps: NDArray[np.int64],
    measured: tuple[Array, Array, Array],
    deltas: Preintegration,
    gyro_bias: Array,
    config: ImuConfig,
) -> Chain:
    """Return the chain that fits the positions best when the measured rotations are taken as they are, eq. (5)."""
    R, p, information = measured
    R, first = R.copy(), _first_seen(information)
    for k in range(first - 1, -1, -1):
        R[k] = R[k + 1] @ deltas.delta_R[k].T
    n, t = len(R), (stamps - stamps[0])[:, None] * 1e-9
    # Position and velocity relative to the first: what the accelerometer gives, and its derivative by the bias, which
    # is told in the frame at each interval's end.
    S, V = np.zeros((n, 3, 4)), np.zeros((n, 3, 4))
    for k in range(n - 1):
        step, end = deltas.duration_s[k], R[k] @ deltas.delta_R[k]
        S[k + 1] = S[k] + V[k] * step
        S[k + 1] += np.column_stack([R[k] @ deltas.delta_p[k], end @ deltas.bias_jacobian[k, 3:6, 3:6]])
        V[k + 1] = V[k] + np.column_stack([R[k] @ deltas.delta_v[k], end @ deltas.bias_jacobian[k, 6:9, 3:6]])
    one = np.tile(np.eye(3), (n, 1, 1))
    A = np.concatenate([one, t[..., None] * one, 0.5 * t[..., None] ** 2 * one, S[:, :, 1:]], axis=2)[first:]
    weighted = np.swapaxes(A, 1, 2) @ information[first:, 3:, 3:]
    H = np.sum(weighted @ A, axis=0)
    H[9:, 9:] += config.accel_bias_sigma**-2.0 * np.eye(3)
    x = np.linalg.solve(H, np.sum(weighted @ (p[first:] - S[first:, :, 0])[..., None], axis=0)[:, 0])
    x0, v0, g, bias = x[0:3], x[3:6], x[6:9], x[9:12]
    g = config.gravity * g / max(float(np.linalg.norm(g)), 1e-9)
    sensed = np.concatenate([[1.0], bias])
    return Chain(
        R=R,
        p=x0 + t * v0 + 0.5 * t**2 * g + S @ sensed,
        v=v0 + t * g + V @ sensed,
        gyro_bias=gyro_bias,
        accel_bias=bias,
        g=g,
    )


def _down_by_force(chain: Chain, deltas: Preintegration) -> Array:
    """Return the direction against the mean force, as if velocity had not changed, (3,)."""
    force = np.einsum("kij,kj->i", chain.R[:-1], deltas.delta_v)
    return np.asarray(-force / max(float(np.linalg.norm(force)), 1e-9))


def _excitation(stamps: NDArray[np.int64], chain: Chain, imu: ImuBatch, poses: Trajectory) -> ImuExcitation:
    inside = (imu.stamps_ns >= stamps[0]) & (imu.stamps_ns <= stamps[-1])
    gyro, accel = (imu.gyro[inside], imu.accel[inside]) if inside.any() else (imu.gyro, imu.accel)
    turns = so3.log(chain.R[0].T @ chain.R)
    return ImuExcitation(
        duration=float(stamps[-1] - stamps[0]) * 1e-9,
        poses=len(poses),
        turned=float(np.linalg.norm(turns, axis=1).max()),
        rate_rms=np.sqrt(np.mean((gyro - chain.gyro_bias) ** 2, axis=0)),
        force_rms=accel.std(axis=0),
    )


def _unobserved(solution: ChainStep, sigmas: Array) -> tuple[str, ...]:
    """Name what the data left nearly as uncertain as it was before them."""
    after = np.sqrt(np.diag(solution.covariance)[9:18])
    names = [*(f"gyro bias {axis}" for axis in _AXES), *(f"accelerometer bias {axis}" for axis in _AXES)]
    blind = [name for name, now, before in zip(names, after, sigmas, strict=False) if now > _UNOBSERVED_SHARE * before]
    if sigmas[8] > 0.0 and after[8] > _UNOBSERVED_SHARE * sigmas[8]:
        blind.append("accelerometer scale")
    return tuple(blind)


def _tilt_covariance(R_odom_imu: Array, g_odom: Array, covariance: Array) -> Array:
    """Return the covariance of gravity's direction in the body frame, (3, 3) [rad^2]."""
    direction = g_odom / np.linalg.norm(g_odom)
    J = np.hstack([so3.hat(R_odom_imu.T @ direction), R_odom_imu.T @ s2.basis(direction)])
    rows = np.array([0, 1, 2, 15, 16])
    return np.asarray(J @ covariance[np.ix_(rows, rows)] @ J.T)


def _judged(found: MotionStart, *, settled: bool) -> MotionStart:
    """Add the verdict; where the data contradict themselves their covariance grows by as much."""
    if found.misfit > _STRAINED_MISFIT:
        found = replace(
            found,
            covariance=found.misfit * found.covariance,
            information=found.information / found.misfit,
            velocity_covariance=found.misfit * found.velocity_covariance,
        )
    tilt, speed = found.gravity_sigma, found.velocity_sigma
    numbers = (
        f"tilt +- {np.degrees(tilt):.2f} deg, velocity +- {speed:.3f} m/s, {found.excitation.poses} poses over "
        f"{found.excitation.duration:.1f} s that turned by {np.degrees(found.excitation.turned):.0f} deg"
    )
    if not settled or found.misfit > _CONTRADICTORY_MISFIT:
        why = (
            f"poses and IMU contradict each other (misfit {found.misfit:.0f} of 1)"
            if settled
            else "no solution settled"
        )
        return replace(found, verdict="failed", reason=f"{why}; {numbers}")
    if tilt > _FAIR_TILT or speed > _FAIR_SPEED:
        verdict = "poor"
    elif tilt > _GOOD_TILT or speed > _GOOD_SPEED or found.misfit > _STRAINED_MISFIT:
        verdict = "fair"
    else:
        verdict = "good"
    return replace(found, verdict=verdict, reason=numbers)
