"""All of a calibration at once, as one graph: LiDAR poses, inertial samples, mounting, clock, gravity and biases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.calibration.states import CalibrationMotion, CalibrationState, LidarPoses, RigPrior
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import CalibrationError
from heliograph.factors import CalibrationPrior, CombinedImu, GravityDirection, LidarPose
from heliograph.graph import (
    Covariance,
    Diagonal,
    FactorGraph,
    Huber,
    Information,
    Isotropic,
    Marginals,
    Prior,
    Solution,
    Values,
    solve,
)
from heliograph.imu import preintegrate
from heliograph.lie import S2, SE3, ExtendedPose, se3, se23

__all__ = ["Estimate", "estimate", "guess_motion", "sampled_at"]


# Keys: the states count from 0, their biases from here; the rest is far above both.
_BIASES, _MOUNTING, _CLOCK, _GRAVITY = 500_000, 1_000_000, 1_000_001, 1_000_002
_POSE_KERNEL = 5.0  # sigmas of a whole pose (6 numbers) beyond which a scan that was placed wrongly loses weight
_VAGUE_SIGMA = 1e3  # one-sigma of what nothing is known of [rad], [m], [m/s]
_RATE_WINDOW_NS = 25_000_000  # on either side of an instant
_NOISE_SCALE_LIMITS = (0.01, 100.0)  # between which that may change in one round


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """The most likely calibration and motion of one graph.

    Parameters
    ----------
    state : CalibrationState
    motion : CalibrationMotion
    covariance : (8, 8) float64
        With the prior: mounting (right perturbation, lidar axes), offset [s], drift [s/s].
    change_by_calibration : (8, 6), (8, 2) float64
        Takes such perturbations to changes from the prior, with imu axes.
    tilt_covariance : (2, 2) float64
        Covariance of gravity's direction [rad^2].
    bias_covariance : (6, 6) float64
        Covariance of the first state's biases.
    poses : LidarPoses
        Those given, with covariances of the size that the residuals show.
    size : (6,) float64
        What their sigmas were multiplied with, by row.
    whitened : (N, 6) float64
        Residuals of the LiDAR's poses in units of that.
    solution : Solution
    """

    state: CalibrationState
    motion: CalibrationMotion
    covariance: Array
    change_by_calibration: tuple[Array, Array]
    tilt_covariance: Array
    bias_covariance: Array
    poses: LidarPoses
    size: Array
    whitened: Array
    solution: Solution

    def __post_init__(self) -> None:
        freeze(self)


def estimate(
    poses: LidarPoses,
    imu: ImuBatch,
    *,
    noise: ImuNoise,
    config: ImuConfig,
    start: CalibrationState,
    motion: CalibrationMotion,
    prior: RigPrior,
    rounds: int = 2,
) -> Estimate:
    """Solve the graph of docs/theory/calibration.md, section 2, with the size of the LiDAR's noise found along.

    Parameters
    ----------
    poses : LidarPoses
        At least three.
    imu : ImuBatch
        Samples around them.
    noise : ImuNoise
        The IMU's noise.
    config : ImuConfig
    start : CalibrationState
        The inertial samples are cut where its clock puts the poses; what the clock changes is a variable.
    motion : CalibrationMotion
        A guess at the same instants.
    prior : RigPrior
    rounds : int
        Solutions, each with the size of the LiDAR's noise that the one before shows.

    Raises
    ------
    CalibrationError
        The poses and the inertial samples do not go together.
    """
    values = _values(start, motion)
    inertial = _inertial(imu, noise, config, start, motion)
    given, size = poses.covariance, np.ones(6)
    for _ in range(rounds):
        graph = _graph(poses, imu, inertial, config, start, motion, prior)
        found = _solve_graph(graph, values)
        values = found.values
        residual = _residual(poses, imu, start, motion, values)
        size = size * _size(poses, residual, _with_calibration_held(graph, values, len(poses)), values)
        poses = replace(poses, covariance=size[:, None] * given * size)
    joint = Marginals(graph, values).joint([_MOUNTING, _CLOCK, _GRAVITY, _BIASES])
    L = np.linalg.cholesky(poses.covariance)
    return Estimate(
        state=_read(values, start),
        motion=_read_motion(values, motion),
        covariance=joint[:8, :8],
        change_by_calibration=_change_by_calibration(values, prior),
        tilt_covariance=joint[8:10, 8:10],
        bias_covariance=joint[10:, 10:],
        poses=poses,
        size=size,
        whitened=np.linalg.solve(L, residual[:, :, None])[:, :, 0],
        solution=found,
    )


def _solve_graph(graph: FactorGraph, values: Values) -> Solution:
    found = solve(graph, values, initial="given")
    if found.status in ("diverged", "indefinite"):
        raise CalibrationError(
            f"LiDAR and IMU do not fit each other (the solver {found.status} after {found.iterations} steps): "
            "check the IMU's axes and units with `heliograph info`, and that both recorded the same motion"
        )
    return found


def _with_calibration_held(graph: FactorGraph, values: Values, count: int) -> Array:
    """Return the states' covariances (N, 9, 9) with mounting and clock held.

    What these leave open moves poses and mounting together, and no residual.
    """
    held = graph.copy()
    held.fix([_MOUNTING, _CLOCK])
    return Marginals(held, values).covariance(np.arange(count))


def guess_motion(poses: LidarPoses, state: CalibrationState, bias: Array) -> CalibrationMotion:
    """Return the IMU's states as the LiDAR's poses and the mounting have them, velocities by differences."""
    T = poses.T_odom_lidar @ se3.inverse(state.T_imu_lidar)
    v = np.gradient(T[:, :3, 3], (poses.stamps_ns - poses.stamps_ns[0]) * 1e-9, axis=0)
    return CalibrationMotion(
        stamps_ns=state.clock.imu_time(poses.stamps_ns),
        X_odom_imu=se23.from_rotation_position_velocity(T[:, :3, :3], T[:, :3, 3], v),
        bias=np.tile(bias, (len(T), 1)),
    )


def sampled_at(imu: ImuBatch, at_ns: NDArray[np.int64], samples: Array) -> Array:
    """Return the samples (M, 3) of a channel at stamps, (N, 3), interpolated linearly."""
    since = (imu.stamps_ns - imu.stamps_ns[0]).astype(np.float64)
    at = (at_ns - imu.stamps_ns[0]).astype(np.float64)
    return np.stack([np.interp(at, since, samples[:, i]) for i in range(3)], axis=1)


def _mean_rates(imu: ImuBatch, at_ns: NDArray[np.int64]) -> Array:
    """Return the gyroscope's mean over a short while about stamps, (N, 3) [rad/s].

    One sample's noise would look like motion: at rest it would seem to tell the clock.
    """
    steps = np.diff(imu.stamps_ns)[:, None] * 1e-9
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (imu.gyro[1:] + imu.gyro[:-1]) * steps, axis=0)])
    begin = np.maximum(at_ns - _RATE_WINDOW_NS, imu.stamps_ns[0])
    end = np.minimum(at_ns + _RATE_WINDOW_NS, imu.stamps_ns[-1])
    return np.asarray((sampled_at(imu, end, turned) - sampled_at(imu, begin, turned)) / ((end - begin)[:, None] * 1e-9))


def _values(start: CalibrationState, motion: CalibrationMotion) -> Values:
    values, keys = Values(), np.arange(len(motion))
    values.insert(keys, ExtendedPose(motion.X_odom_imu))
    values.insert(_BIASES + keys, motion.bias)
    values.insert(_MOUNTING, SE3(start.T_imu_lidar))
    values.insert(_CLOCK, np.zeros(2))
    values.insert(_GRAVITY, S2(start.g_odom))
    return values


def _inertial(
    imu: ImuBatch, noise: ImuNoise, config: ImuConfig, start: CalibrationState, motion: CalibrationMotion
) -> CombinedImu:
    """Return the factors of the inertial samples between the states."""
    at, keys = motion.stamps_ns, np.arange(len(motion))
    # Interpolating between samples adds noise for an odometry that must not be surprised by a slow IMU; here it would
    # only blur sigmas, and what it stands for shows in the residuals.
    exact = replace(config, curvature=0.0)
    motions = preintegrate(
        imu,
        at[:-1],
        at[1:],
        noise=noise,
        config=exact,
        gyro_bias=motion.bias[:-1, :3],
        accel_bias=motion.bias[:-1, 3:],
    )
    gravity = GravityDirection(key=_GRAVITY, magnitude=float(np.linalg.norm(start.g_odom)))
    return CombinedImu(
        keys[:-1],
        _BIASES + keys[:-1],
        keys[1:],
        _BIASES + keys[1:],
        motions,
        gravity=gravity,
        keep_samples=False,  # each round integrates again, at the biases found
    )


def _graph(
    poses: LidarPoses,
    imu: ImuBatch,
    inertial: CombinedImu,
    config: ImuConfig,
    start: CalibrationState,
    motion: CalibrationMotion,
    prior: RigPrior,
) -> FactorGraph:
    graph, keys = FactorGraph(), np.arange(len(poses))
    graph.add(inertial)
    graph.add(
        LidarPose(
            keys,
            _MOUNTING,
            _CLOCK,
            *_pose_data(poses, imu, start, motion),
            Covariance(poses.covariance),
            kernel=Huber(_POSE_KERNEL),
        )
    )
    # So vague that they tell nothing; with them it shows without an analysis that the graph determines every variable.
    vague = Isotropic(_VAGUE_SIGMA)
    graph.add(Prior(keys, ExtendedPose(motion.X_odom_imu), vague))
    graph.add(Prior(_BIASES + keys, motion.bias, vague))
    graph.add(Prior(_GRAVITY, S2(start.g_odom), vague))
    graph.add(Prior(_MOUNTING, SE3(start.T_imu_lidar), vague))
    graph.add(Prior(_CLOCK, np.zeros(2), vague))
    biases = Diagonal([config.gyro_bias_sigma] * 3 + [config.accel_bias_sigma] * 3)
    graph.add(Prior(_BIASES, np.zeros(6), biases))
    change = [prior.clock.offset - start.clock.offset, prior.clock.drift - start.clock.drift]
    graph.add(CalibrationPrior(_MOUNTING, _CLOCK, SE3(prior.T_imu_lidar), change, Information(prior.information)))
    return graph


def _pose_data(
    poses: LidarPoses, imu: ImuBatch, start: CalibrationState, motion: CalibrationMotion
) -> tuple[SE3, Array, Array]:
    """Return what the factor of the LiDAR's poses is made of: poses, body rates, seconds since the reference."""
    omega = _mean_rates(imu, motion.stamps_ns) - motion.bias[:, :3]
    span = np.asarray((poses.stamps_ns - start.clock.reference_ns) * 1e-9, dtype=np.float64)
    return SE3(poses.T_odom_lidar), omega, span


def _residual(
    poses: LidarPoses, imu: ImuBatch, start: CalibrationState, motion: CalibrationMotion, values: Values
) -> Array:
    keys = np.arange(len(poses))
    factors = LidarPose(keys, _MOUNTING, _CLOCK, *_pose_data(poses, imu, start, motion), Isotropic(1.0))
    return factors.evaluate(values.at(keys), values.at(_MOUNTING), values.at(_CLOCK))[0]


def _size(poses: LidarPoses, residual: Array, X_covariance: Array, values: Values) -> Array:
    """Return by how much the noise is larger than its covariance says, as a factor on sigma for each row, (6,).

    A residual's expected square is its variance less what the estimate took of it, so that
    ``s^2 = sum r^2 / sum (C - J P J^T)`` (variance components: W. Förstner, 1979). With n degrees of freedom left in
    the residuals that is itself uncertain, and errors follow Student's distribution, whose variance is
    ``n / (n - 2)`` times as large. Scans beyond the kernel are left out.
    """
    E = values.at(_MOUNTING).matrix
    by_state = np.zeros((6, 9))
    by_state[:, :6] = se3.adjoint(se3.inverse(E))
    taken = np.einsum("ij,njk,ik->ni", by_state, X_covariance, by_state)
    expected = np.diagonal(poses.covariance, axis1=1, axis2=2)
    square = np.einsum("ni,ni->n", residual, np.linalg.solve(poses.covariance, residual[:, :, None])[:, :, 0])
    # Judged against the median, which a few wrong ones do not move: 5.35 is that of 6 squared standard normals.
    good = square <= _POSE_KERNEL**2 * float(np.median(square)) / 5.348
    expected, left = expected[good], np.maximum(expected - taken, 0.05 * expected)[good]
    freedom = np.maximum((left / expected).sum(axis=0), 3.0)
    square_size = (residual[good] ** 2).sum(axis=0) / left.sum(axis=0) * freedom / (freedom - 2.0)
    return np.asarray(np.sqrt(np.clip(square_size, *_NOISE_SCALE_LIMITS)))


def _change_by_calibration(values: Values, prior: RigPrior) -> tuple[Array, Array]:
    clock = values.at(_CLOCK)
    factor = CalibrationPrior(_MOUNTING, _CLOCK, SE3(prior.T_imu_lidar), clock, Isotropic(1.0))
    by_mounting, by_clock = factor.evaluate(values.at(_MOUNTING), clock)[1]
    return by_mounting[0], by_clock[0]


def _read(values: Values, start: CalibrationState) -> CalibrationState:
    offset, drift = values.at(_CLOCK)
    clock = replace(start.clock, offset=start.clock.offset + float(offset), drift=start.clock.drift + float(drift))
    return CalibrationState(
        T_imu_lidar=values.at(_MOUNTING).matrix,
        clock=clock,
        g_odom=float(np.linalg.norm(start.g_odom)) * values.at(_GRAVITY).vector,
    )


def _read_motion(values: Values, motion: CalibrationMotion) -> CalibrationMotion:
    keys = np.arange(len(motion.stamps_ns))
    return replace(motion, X_odom_imu=values.at(keys).matrix, bias=values.at(_BIASES + keys))
