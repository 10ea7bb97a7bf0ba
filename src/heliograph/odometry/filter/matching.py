"""One scan against the map: thinning, a kernel that narrows as the pose settles, the iterated update, and its trust."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.cloud import voxel_downsample
from heliograph.config import CloudConfig, FilterConfig, RunConfig
from heliograph.data import NavState
from heliograph.data.error_layout import GYRO_BIAS, POSITION, ROTATION, VELOCITY
from heliograph.imu import ErrorGrowth
from heliograph.maps import LocalMap
from heliograph.odometry.filter.alike import AlikeErrors
from heliograph.odometry.filter.bending import SweepBend, sweep_bend
from heliograph.odometry.filter.calibrating import CalibrationTerms
from heliograph.odometry.filter.error_state import mounting_error
from heliograph.odometry.filter.innovation import InnovationTest
from heliograph.odometry.filter.lasting import MatchedPoints
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.sight import SeenInformation, SightOfScans
from heliograph.odometry.filter.update import FilterUpdate, iterated_update, weighed_less
from heliograph.registration import MatchSettings, NormalEquations, linearize
from heliograph.snapshots import PART, Stateful

__all__ = ["AdaptiveNoise", "ScanMatcher", "Thinning", "register", "sweep_noise"]

_UNTOLD = 30.0  # matches that count as one where the map does not tell how well it knows its normals
_OPENING_SIGMAS = 2.0  # of the predicted position, that the first kernel's scale spans
_VAGUE_RATIO = 3.0  # first by final kernel scale, beyond which a prediction is vague
_NOISE_GAIN, _SHARE_GAIN = 0.1, 0.1  # weights of the latest scan in the running means of noise and matched share
_FIRST_LEAF = 0.4  # cube edge that the first scan is thinned with [m]
_LEAF_TOLERANCE = 0.1  # relative error of the number of points picked that leaves the edge as it is
_LEAF_STEP = 2.0  # largest factor by which the edge changes from scan to scan
_MOTION_DIM = GYRO_BIAS.stop  # errors of pose and motion
# Variance of value, covariance of value and slope, variance of slope at zero of the line fitted to a Wiener process on
# [0, 1], and of that fitted to the integral of one.
_TURNED_LINE = (2.0 / 15.0, -1.0 / 10.0, 6.0 / 5.0)
_MOVED_LINE = (1.0 / 105.0, -11.0 / 210.0, 13.0 / 35.0)
_BENT_SCALES = 3.0  # final kernels that the kernel spans which looks at how bent a sweep is
_SCALE_ITERATIONS = 4  # an iterated update stays no longer at one scale of its kernel


class Thinning(Stateful):
    """Picks about ``target_points`` of a scan, spread evenly; the cube's edge follows from scan to scan.

    On surfaces the number of cubes falls with the square of their edge, so one step of the square root comes close.
    """

    _STATE: ClassVar = {
        "_leaf": float,
    }

    def __init__(self, config: CloudConfig) -> None:
        self._config = config
        self._leaf = float(np.clip(_FIRST_LEAF, config.min_leaf, config.max_leaf))

    def pick(self, points: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the indices of the points picked, (M,) int32."""
        picked = voxel_downsample(points, self._leaf)
        if len(picked) > 0:
            ratio = len(picked) / self._config.target_points
            # Dead zone: an edge that never settles would make two equal scans differ.
            if not 1.0 - _LEAF_TOLERANCE < ratio < 1.0 + _LEAF_TOLERANCE:
                leaf = self._leaf * float(np.clip(np.sqrt(ratio), 1.0 / _LEAF_STEP, _LEAF_STEP))
                self._leaf = float(np.clip(leaf, self._config.min_leaf, self._config.max_leaf))
        return picked


@dataclass(frozen=True, slots=True)
class AdaptiveNoise:
    """Range noise across planes, as the residuals of past scans show it."""

    sigma: float

    def updated(self, rms: float, config: FilterConfig) -> AdaptiveNoise:
        """Return the estimate after one more scan with the robust RMS ``rms`` [m]."""
        if not np.isfinite(rms):
            return self
        sigma = float(np.clip((1.0 - _NOISE_GAIN) * self.sigma + _NOISE_GAIN * rms, config.min_sigma, config.max_sigma))
        return AdaptiveNoise(sigma)


def sweep_noise(growth: ErrorGrowth) -> Array:
    """Return what an IMU's white noise within a sweep feigns of pose, velocity and gyroscope bias, (12, 12).

    At a time s before the sweep's end, noise of the rate has turned the points by ``W(s)``, a Wiener process of
    variance ``q s``, and noise of the force has moved them by the integral of one. Matches tell these from errors of
    the state only by their curvature: the line fitted through either, its value and slope at the end, is taken for an
    error of pose and bias, or of pose and velocity. The numbers are the covariance of that line, by least squares over
    a sweep of even times; the prediction has ``q T`` and ``q T^3 / 3`` as what noise has added to rotation and position
    over it.
    """
    added, T = growth.added, max(growth.span, 1e-3)
    B = np.zeros((_MOTION_DIM, _MOTION_DIM))
    for value, slope, sign, noise, numbers in (
        (ROTATION, GYRO_BIAS, 1.0, added[ROTATION, ROTATION], _TURNED_LINE),
        (POSITION, VELOCITY, -1.0, 3.0 * added[POSITION, POSITION], _MOVED_LINE),
    ):
        B[value, value] = numbers[0] * noise
        B[value, slope] = B[slope, value] = sign * numbers[1] / T * noise
        B[slope, slope] = numbers[2] / T**2 * noise
    return B


def register(
    prior: NavState,
    local_map: LocalMap,
    points_at: Callable[[NavState], NDArray[np.float32]],
    before_end: NDArray[np.float32],
    *,
    noise: AdaptiveNoise,
    config: FilterConfig,
    threads: int,
    terms: CalibrationTerms | None = None,
    sweep_noise: Array | None = None,
    sight: SightOfScans | None = None,
    alike: float = 1.0,
) -> FilterUpdate[ScanMeasurement]:
    """Update a predicted state with the points of a scan.

    The kernel narrows down to ``config.kernel`` sigmas as the pose settles (graduated non-convexity in its simplest
    form), so that a poor prediction still finds its planes and a good one is not disturbed by wrong ones.

    Parameters
    ----------
    prior : NavState
        Predicted to the scan's end.
    local_map : LocalMap
        Not empty.
    points_at : callable
        ``points_at(state)`` returns the points, de-skewed with the motion that a state at the scan's end makes of the
        sweep, (N, 3) float32, imu frame at the end [m].
    before_end : (N,) float32
        Time of each point before the scan's end [s].
    noise : AdaptiveNoise
        Range noise across planes.
    config : FilterConfig
        Kernel, gate, tolerances, and how many matches count as one.
    threads : int
        Threads of the native loops; the result does not depend on them.
    terms : CalibrationTerms, optional
        What is estimated of mounting and clock. Points and map were made with ``terms.mounted.T_imu_lidar``; where the
        state's mounting differs from it, the residuals are corrected to first order.
    sweep_noise : (12, 12) float64, optional
        Covariance of what noise of the IMU within the sweep feigns of pose, velocity and gyroscope bias.
    sight : SightOfScans, optional
        What the scans before saw.
    alike : float
        How many times more the errors of the scans before were than if all their matches were independent.

    Returns
    -------
    FilterUpdate
        The posterior, and the measurement as linearised last.

    Raises
    ------
    ConfigError
        An unknown residual, or point residuals on a map that has none.

    Notes
    -----
    After W. Xu et al., "FAST-LIO2", T-RO 2022; eq. (3) to (7) of docs/theory/filter.md.
    """
    terms = terms if terms is not None else CalibrationTerms()
    mounted, sight = terms.mounted, sight if sight is not None else SightOfScans()
    blur = float(before_end.max(initial=0.0)) ** 2 * float(np.linalg.eigvalsh(prior.covariance[VELOCITY, VELOCITY])[-1])
    motion_known = blur < noise.sigma**2
    opening = _opening(prior, noise.sigma, config, terms)
    kernel = _NarrowingKernel(opening, config.kernel * noise.sigma, config.typical_range)

    def measure(state: NavState, iteration: int) -> ScanMeasurement:
        scale = kernel.at(state, iteration)
        settings = MatchSettings(
            gate=config.gate * scale,
            kernel=scale,
            sigma=noise.sigma,
            fallback_stride=config.fallback_stride if mounted is None else 0,
            residual=config.residual,
            threads=threads,
        )
        sums = linearize(
            local_map,
            points_at(state),
            state.T_odom_imu,
            settings,
            before_end=before_end if terms.motion else None,
            mounted=mounted,
        )
        measurement = ScanMeasurement.of(sums)
        if mounted is not None:
            measurement = measurement.at_mounting(mounting_error(mounted.T_imu_lidar, state.T_imu_lidar))
        measurement = measurement.only_true(sight, state, motion_known=motion_known)
        if terms.rate_change is not None:
            measurement = measurement.with_clock(terms.rate_change)
        shared = config.correlation if sums.feigned_square > 0.0 else max(config.correlation, _UNTOLD)
        measurement = measurement.scaled(1.0 / (alike * shared))
        return measurement if sweep_noise is None or not terms.motion else measurement.blurred(sweep_noise)

    return iterated_update(
        prior,
        measure,
        max_iterations=config.max_iterations + kernel.max_iterations,
        tolerance_rotation=config.tolerance_rotation,
        tolerance_position=config.tolerance_position,
        settled=lambda _: kernel.scale <= kernel.final,
        considered=terms.considered,
    )


class ScanMatcher(Stateful):
    """Matches scans to a map, and remembers of them how noisy they are and how much of them usually matches.

    Parameters
    ----------
    config : RunConfig
    threads : int
        Threads of the native loops; the result does not depend on them.
    """

    _STATE: ClassVar = {
        "noise": AdaptiveNoise,
        "thinning": PART,
        "_usual_share": float,
        "_innovations": PART,
        "_sight": PART,
        "_alike": PART,
    }

    def __init__(self, config: RunConfig, *, threads: int) -> None:
        self.noise = AdaptiveNoise(config.filter.sigma)
        self.thinning = Thinning(config.cloud)
        self._config, self._threads = config.filter, threads
        self._usual_share = 0.0
        self._innovations = InnovationTest()
        self._sight = SightOfScans()
        self._alike = AlikeErrors(config.filter.typical_range)

    @property
    def usual_share(self) -> float:
        """Share of the points that usually match."""
        return self._usual_share

    def matched(
        self, points_imu: NDArray[np.float32], picked: NDArray[np.int32], state: NavState, local_map: LocalMap
    ) -> MatchedPoints:
        """Return how the picked ones of a scan's points were matched at last, and learn how they err together."""
        matched = MatchedPoints(points_imu=points_imu[picked], settings=self._final(1.0))
        self._alike.learn(local_map, matched.points_imu, state, matched.settings)
        return matched

    def _final(self, times: float) -> MatchSettings:
        """Return how matches are made at last, with a kernel wider by a factor."""
        scale = times * self._config.kernel * self.noise.sigma
        return MatchSettings(
            gate=self._config.gate * scale, kernel=scale, sigma=self.noise.sigma, threads=self._threads
        )

    def bend(
        self,
        points_imu: NDArray[np.float32],
        before_end: NDArray[np.float32],
        state: NavState,
        local_map: LocalMap,
    ) -> SweepBend:
        """Return how far a sweep is bent from the motion that its points were de-skewed with, at its fitted state."""
        return sweep_bend(
            points_imu,
            before_end,
            state,
            local_map,
            self._final(_BENT_SCALES),
            correlation=self._alike.factor * self._config.correlation,
            forgiven=self._final(1.0).gate,
        )

    def match(
        self,
        prior: NavState,
        local_map: LocalMap,
        points_at: Callable[[NavState], NDArray[np.float32]],
        before_end: NDArray[np.float32],
        terms: CalibrationTerms,
        sweep_noise: Array | None = None,
    ) -> FilterUpdate[ScanMeasurement] | None:
        """Return what `register` makes of a scan, None where too few points match to trust it.

        Where an IMU predicts, and ``sweep_noise`` is given, a correction that it does not allow weighs less.
        """
        fit = self.registered(prior, local_map, points_at, before_end, terms, sweep_noise)
        if not self._trusted(prior, fit.measurement.sums, terms):
            return None
        together = fit.measurement.together
        self._sight.take(together or SeenInformation.of(fit.measurement.sums, fit.linearized_at))
        return fit if sweep_noise is None else self._believed(fit, prior, terms)

    def registered(
        self,
        prior: NavState,
        local_map: LocalMap,
        points_at: Callable[[NavState], NDArray[np.float32]],
        before_end: NDArray[np.float32],
        terms: CalibrationTerms,
        sweep_noise: Array | None = None,
    ) -> FilterUpdate[ScanMeasurement]:
        """Return what `register` makes of a scan, trusted or not."""
        return register(
            prior,
            local_map,
            points_at,
            before_end,
            noise=self.noise,
            config=self._config,
            threads=self._threads,
            terms=terms,
            sweep_noise=sweep_noise,
            sight=self._sight,
            alike=self._alike.factor,
        )

    def _believed(
        self, fit: FilterUpdate[ScanMeasurement], prior: NavState, terms: CalibrationTerms
    ) -> FilterUpdate[ScanMeasurement]:
        """Return the update with a registration that weighs as much as its agreement with the IMU allows."""
        excess = self._innovations.excess(fit.nis)
        self._innovations.add(fit.nis)
        if excess > 1.0:
            fit = weighed_less(fit, prior, fit.measurement.scaled(1.0 / excess), terms.considered)
        return replace(fit, excess=excess)

    def _trusted(self, prior: NavState, found: NormalEquations, terms: CalibrationTerms) -> bool:
        """Whether enough points match; after a vague prediction that also means: about as many as before it.

        A scan that was led to a wrong place by a prediction that allowed for one finds planes there too, but fewer.
        """
        config = self._config
        if found.matches < config.min_matches:
            return False
        share = found.matches / found.queries
        if share < config.vague_share * self._usual_share and _is_vague(prior, self.noise, config, terms):
            return False
        self._usual_share += _SHARE_GAIN * (share - self._usual_share) if self._usual_share > 0.0 else share
        return True


def _opening(prior: NavState, sigma: float, config: FilterConfig, terms: CalibrationTerms) -> float:
    """Kernel scale of the first iteration: wide enough for what the prediction does not know [m]."""
    covariance = terms.map_pose_covariance(prior)
    position = float(np.linalg.eigvalsh(covariance[POSITION, POSITION])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[ROTATION, ROTATION])[-1])
    unknown = np.sqrt(max(position, 0.0) + config.typical_range**2 * max(rotation, 0.0))
    return float(np.clip(_OPENING_SIGMAS * unknown, config.kernel * sigma, config.max_kernel))


def _is_vague(prior: NavState, noise: AdaptiveNoise, config: FilterConfig, terms: CalibrationTerms) -> bool:
    """Whether the prediction allows for errors well beyond what the final kernel forgives."""
    return _opening(prior, noise.sigma, config, terms) > _VAGUE_RATIO * config.kernel * noise.sigma


class _NarrowingKernel:
    """A kernel's scale that halves when the pose has settled at it, or after `_SCALE_ITERATIONS` iterations."""

    def __init__(self, start: float, final: float, typical_range: float) -> None:
        self.scale, self.final, self._range = start, final, typical_range
        self._last: NavState | None = None
        self._stay = 0

    @property
    def max_iterations(self) -> int:
        """Most iterations until the scale is the final one."""
        return _SCALE_ITERATIONS * int(np.ceil(np.log2(self.scale / self.final)))

    def at(self, state: NavState, iteration: int) -> float:
        """Return the scale [m] for an iteration that begins at ``state``."""
        if iteration > 0 and self._last is not None:
            shift = float(np.linalg.norm(state.p_odom - self._last.p_odom))
            turn = float(np.linalg.norm(state.R_odom_imu - self._last.R_odom_imu)) / np.sqrt(2.0)
            self._stay += 1
            if shift + self._range * turn < 0.5 * self.scale or self._stay >= _SCALE_ITERATIONS:
                self.scale, self._stay = max(self.final, 0.5 * self.scale), 0
        self._last = state
        return self.scale
