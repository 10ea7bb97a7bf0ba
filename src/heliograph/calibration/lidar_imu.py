"""LiDAR-IMU calibration: rotation, lever arm, clock, gravity and biases of a recording, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.calibration.batch import Estimate, sampled_at
from heliograph.calibration.coarse import align_turns
from heliograph.calibration.gather import CalibrationData, Message, gather, refined
from heliograph.calibration.observability import (
    CalibratedAxis,
    Observed,
    judge_axes,
    kept_in_words,
    prior_sigmas,
)
from heliograph.calibration.placing import Placer, lidar_path
from heliograph.calibration.rounds import CalibrationRounds, change_from, run_rounds
from heliograph.calibration.states import CalibrationState, LidarPoses, RigPrior
from heliograph.config import ImuConfig, RunConfig
from heliograph.data import ImuBatch, ImuClock, ImuNoise, Rig
from heliograph.errors import DataError
from heliograph.imu import assess_stillness
from heliograph.imu.white_floor import noise_in_motion
from heliograph.lie import se3, so3

__all__ = ["AxisExcitation", "Calibration", "calibrate"]


_ODOMETRY_SIGMA = (0.02, 0.03)  # one-sigma of the LiDAR's own odometry to begin with [rad], [m]; its size is found
_REST_WINDOW_NS, _MIN_REST_SAMPLES = 1_000_000_000, 20


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisExcitation:
    """How much the motion used one axis of the IMU.

    Parameters
    ----------
    axis : str
        ``"x"``, ``"y"`` or ``"z"``, of the IMU.
    rate, acceleration : float
        Root mean square of the body rate about it [rad/s] and of the acceleration along it, gravity taken off [m/s^2].
    rotation_gain, lever_gain : float
        The prior's sigma over the sigma that the data left.
    """

    axis: str
    rate: float
    acceleration: float
    rotation_gain: float
    lever_gain: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What `calibrate` found.

    Parameters
    ----------
    rig : Rig
        Mounting and clock to use: the prior along what was not excited.
    prior : Rig
        What it began from.
    axes : tuple of CalibratedAxis
        The eight numbers with sigma and verdict.
    observed : Observed
        The same by independent directions, imu axes.
    kept : tuple of str
        One line for each direction that kept its prior.
    excitation : tuple of AxisExcitation
    g_odom, tilt_sigma : (3,) float64, float
        Gravity in the frame of the first scan's LiDAR [m/s^2], and the larger one-sigma of its direction [rad].
    gyro_bias, accel_bias, bias_sigma : (3,), (3,), (6,) float64
        At the first scan used [rad/s], [m/s^2].
    noise : ImuNoise
        The IMU's noise, as used.
    duration : float
        Data used [s].
    scans, passes : int
        Scans used; rounds of placing and solving.
    converged : bool
        Whether the last round changed nothing that matters.
    residual_rotation, residual_position : float
        Noise of one scan's pose, as the residuals show it: root mean square an axis [rad], [m].
    """

    rig: Rig
    prior: Rig
    axes: tuple[CalibratedAxis, ...]
    observed: Observed
    kept: tuple[str, ...]
    excitation: tuple[AxisExcitation, ...]
    g_odom: Array
    tilt_sigma: float
    gyro_bias: Array
    accel_bias: Array
    bias_sigma: Array
    noise: ImuNoise
    duration: float
    scans: int
    passes: int
    converged: bool
    residual_rotation: float
    residual_position: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def covariance(self) -> Array:
        """Covariance of rotation about and lever arm along imu axes, offset and drift, (8, 8) in SI units."""
        return self.observed.covariance


def calibrate(
    stream: Iterable[Message], rig: Rig, config: RunConfig, *, noise: ImuNoise | None = None, threads: int = 1
) -> Calibration:
    """Calibrate the mounting and the clock of a recording.

    The LiDAR alone gives a first path and, against the gyroscope, a first rotation and clock offset. Then rounds: one
    graph of all scans' poses and all inertial samples is solved for motion, mounting, clock, gravity and biases; with
    that every scan is de-skewed and placed again. Directions that the motion did not excite keep their prior.

    Parameters
    ----------
    stream : iterable of Scan and ImuBatch
        The messages of a recording; read once.
    rig : Rig
        The prior; its mounting to the sigmas of ``config.calibration``, or to its own where it is
        not known at all. The samples come with the rig's own clock applied; what is found is on top of it.
    config : RunConfig
    noise : ImuNoise, optional
        The IMU's noise; found from a rest in the recording, or else assumed, where not given.
    threads : int

    Raises
    ------
    DataError
        Too few scans or samples.
    CalibrationError
        LiDAR and IMU do not fit each other.
    """
    config = _for_rig(config, rig)
    evidence = gather(stream, config, threads=threads)
    noise = noise or measured_noise(evidence.imu, config.imu)
    evidence = replace(evidence, imu=refined(evidence.imu))
    run = _Run(evidence, config, noise, threads)
    prior = run.prior(rig)
    return run.conclude(rig, prior, run.rounds(prior))


def _for_rig(config: RunConfig, rig: Rig) -> RunConfig:
    """Widen the prior where the mounting is unknown."""
    if rig.known:
        return config
    widened = replace(
        config.calibration,
        prior_rotation_deg=max(config.calibration.prior_rotation_deg, float(np.degrees(rig.sigma_rotation))),
        prior_lever=max(config.calibration.prior_lever, rig.sigma_translation),
    )
    return replace(config, calibration=widened)


@dataclass(frozen=True, slots=True)
class _Run:
    """The steps of one calibration, on its data."""

    evidence: CalibrationData
    config: RunConfig
    noise: ImuNoise
    threads: int

    def prior(self, rig: Rig) -> RigPrior:
        ends = self.evidence.ends_ns
        middle_ns = int(ends[0] + (ends[-1] - ends[0]) // 2)  # where offset and drift are uncorrelated
        sigmas = prior_sigmas(self.config.calibration)
        return RigPrior(
            T_imu_lidar=rig.T_imu_lidar,
            clock=ImuClock(reference_ns=middle_ns),
            information=np.diag(sigmas**-2.0),
        )

    def first(self, prior: RigPrior) -> tuple[CalibrationState, LidarPoses, Array]:
        """Return the calibration, poses of the LiDAR and the gyroscope's bias to begin with."""
        calibration, evidence = self.config.calibration, self.evidence
        coarse = align_turns(
            evidence.ends_ns,
            evidence.T_odom_lidar[:, :3, :3],
            evidence.imu,
            R_prior=prior.T_imu_lidar[:3, :3],
            sigma_rotation=float(np.radians(calibration.prior_rotation_deg)),
            search=calibration.search,
            sigma_offset=calibration.prior_offset,
        )
        T = se3.from_rotation_translation(coarse.R_imu_lidar, prior.T_imu_lidar[:3, 3])
        clock = replace(prior.clock, offset=coarse.offset)
        poses = self._keep_covered(
            LidarPoses(
                stamps_ns=evidence.ends_ns,
                T_odom_lidar=evidence.T_odom_lidar,
                covariance=np.tile(np.diag(np.repeat(_ODOMETRY_SIGMA, 3) ** 2), (len(evidence.scans), 1, 1)),
            ),
            clock,
        )
        force = sampled_at(evidence.imu, clock.imu_time(poses.stamps_ns), evidence.imu.accel)
        R_odom_imu = poses.T_odom_lidar[:, :3, :3] @ coarse.R_imu_lidar.T
        up = np.einsum("nij,nj->i", R_odom_imu, force)
        g_odom = -self.config.imu.gravity * up / np.linalg.norm(up)
        state = CalibrationState(T_imu_lidar=T, clock=clock, g_odom=g_odom)
        return state, poses, np.concatenate([coarse.gyro_bias, np.zeros(3)])

    def _keep_covered(self, poses: LidarPoses, clock: ImuClock) -> LidarPoses:
        """Return the poses that lie within the inertial samples."""
        at, stamps = clock.imu_time(poses.stamps_ns), self.evidence.imu.stamps_ns
        inside = (at >= stamps[0]) & (at <= stamps[-1])
        if np.count_nonzero(inside) < 3:
            raise DataError(
                f"{np.count_nonzero(inside)} of {len(poses)} scans lie within the inertial samples: the two "
                "sensors did not record at the same time, or their clocks differ by seconds; see `heliograph info`"
            )
        return LidarPoses(
            stamps_ns=poses.stamps_ns[inside],
            T_odom_lidar=poses.T_odom_lidar[inside],
            covariance=poses.covariance[inside],
        )

    def rounds(self, prior: RigPrior) -> CalibrationRounds:
        """Solve, de-skew and place in turn."""
        placer = Placer(self.evidence.scans, self.config, threads=self.threads)

        def place(found: Estimate) -> LidarPoses:
            path = lidar_path(found.motion, found.state, self.evidence.imu, self.noise, self.config.imu)
            return placer.place(path)

        state, poses, bias = self.first(prior)
        return run_rounds(
            poses, place, self.evidence.imu, noise=self.noise, config=self.config, prior=prior, start=state, bias=bias
        )

    def conclude(self, rig: Rig, prior: RigPrior, rounds: CalibrationRounds) -> Calibration:
        """Put the prior back along what was not excited, and give an account."""
        found, config = rounds.estimate, self.config.calibration
        change = rounds.observed.observed_part(change_from(prior, found.state))
        T = prior.T_imu_lidar.copy()
        T[:3, :3] = so3.exp(change[:3]) @ T[:3, :3]
        T[:3, 3] += change[3:6]
        clock = replace(prior.clock, offset=float(change[6]), drift=float(change[7]))
        # The directions are changes from the prior; what is reported are errors of the result.
        back = np.eye(8)
        back[:3, :3] = so3.left_jacobian(change[:3])
        observed = replace(rounds.observed, directions=back @ rounds.observed.directions)
        axes = judge_axes(observed, np.concatenate([change[:3], T[:3, 3], [clock.offset, clock.drift]]), config)
        noise = np.sqrt(np.mean(np.diagonal(found.poses.covariance, axis1=1, axis2=2), axis=0))
        return Calibration(
            rig=Rig(T_imu_lidar=T, source="calibrated", clock=clock.after(rig.clock)),
            prior=rig,
            axes=axes,
            observed=observed,
            kept=kept_in_words(observed, prior_sigmas(config)),
            excitation=self._excitation(found, axes),
            g_odom=found.state.g_odom,
            tilt_sigma=float(np.sqrt(np.linalg.eigvalsh(found.tilt_covariance)[-1])),
            gyro_bias=found.motion.bias[0, :3].copy(),
            accel_bias=found.motion.bias[0, 3:].copy(),
            bias_sigma=np.sqrt(np.diag(found.bias_covariance)),
            noise=self.noise,
            duration=self.evidence.duration,
            scans=len(found.poses),
            passes=rounds.passes,
            converged=rounds.converged,
            residual_rotation=float(np.sqrt(np.mean(noise[:3] ** 2))),
            residual_position=float(np.sqrt(np.mean(noise[3:] ** 2))),
        )

    def _excitation(self, found: Estimate, axes: tuple[CalibratedAxis, ...]) -> tuple[AxisExcitation, ...]:
        imu, motion = self.evidence.imu, found.motion
        rate = sampled_at(imu, motion.stamps_ns, imu.gyro) - motion.bias[:, :3]
        force = sampled_at(imu, motion.stamps_ns, imu.accel) - motion.bias[:, 3:]
        acceleration = force + np.einsum("nji,j->ni", motion.X_odom_imu[:, :3, :3], found.state.g_odom)
        return tuple(
            AxisExcitation(
                axis="xyz"[k],
                rate=float(np.sqrt(np.mean(rate[:, k] ** 2))),
                acceleration=float(np.sqrt(np.mean(acceleration[:, k] ** 2))),
                rotation_gain=axes[k].prior_sigma / axes[k].sigma,
                lever_gain=axes[3 + k].prior_sigma / axes[3 + k].sigma,
            )
            for k in range(3)
        )


def measured_noise(imu: ImuBatch, config: ImuConfig) -> ImuNoise:
    """Return the noise of an IMU from the seconds at rest in a recording, or of one never at rest."""
    rests, half = [], _REST_WINDOW_NS // 2
    # Only windows with a sample in them: of a gap in the stamps there is any number.
    steps = np.unique(((imu.stamps_ns - imu.stamps_ns[0]) // half)[:, None] + np.array([-1, 0]))
    starts = int(imu.stamps_ns[0]) + steps[steps >= 0] * half
    for start in starts[starts <= int(imu.stamps_ns[-1]) - _REST_WINDOW_NS].tolist():
        first, last = np.searchsorted(imu.stamps_ns, [start, start + _REST_WINDOW_NS]).tolist()
        if last - first >= _MIN_REST_SAMPLES:
            rest = assess_stillness(
                replace(
                    imu,
                    stamps_ns=imu.stamps_ns[first:last],
                    gyro=imu.gyro[first:last],
                    accel=imu.accel[first:last],
                ),
                config,
            )
            rests += [rest.noise] if rest.still and not rest.biased else []
    if not rests:
        return noise_in_motion(imu, config)
    # The median: the calmest of many would be too calm by chance, the mean is moved by a second that was not at rest.
    gyro, accel = (float(np.median([getattr(rest, name) for rest in rests])) for name in ("gyro", "accel"))
    return replace(rests[0], gyro=gyro, accel=accel)
