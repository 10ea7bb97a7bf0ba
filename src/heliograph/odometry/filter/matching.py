"""One scan against the map: thinning, a kernel that narrows as the pose settles, and the iterated update."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.cloud import voxel_downsample
from heliograph.config import CloudConfig, FilterConfig
from heliograph.data import NavState
from heliograph.maps import LocalMap
from heliograph.odometry.filter.error_state import CLOCK, MOUNTING, NAV_DIM, mounting_error
from heliograph.odometry.filter.update import UpdateResult, iterated_update
from heliograph.registration import MatchSettings, NormalEquations, linearize

__all__ = ["AdaptiveNoise", "Online", "Thinning", "is_vague", "register", "with_clock"]

# A prediction's rotation error moves points by its sine times their distance; this distance stands for the cloud.
_TYPICAL_RANGE = 15.0


class Thinning:
    """Picks about ``target_points`` of a scan, spread evenly; the cube's edge follows from scan to scan.

    On surfaces the number of cubes falls with the square of their edge, so one step of the square root comes close.
    """

    def __init__(self, config: CloudConfig) -> None:
        self._config = config
        self._leaf = float(np.clip(0.4, config.min_leaf, config.max_leaf))

    def pick(self, points: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the indices of the points picked, (M,) int32."""
        picked = voxel_downsample(points, self._leaf)
        if len(picked) > 0:
            ratio = len(picked) / self._config.target_points
            # Dead zone: an edge that never settles would make two equal scans differ.
            if not 0.9 < ratio < 1.1:
                leaf = self._leaf * float(np.clip(np.sqrt(ratio), 0.5, 2.0))
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
        sigma = float(np.clip(0.9 * self.sigma + 0.1 * rms, config.min_sigma, config.max_sigma))
        return AdaptiveNoise(sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class Online:
    """What an update needs to know where mounting and clock are among the states.

    Parameters
    ----------
    considered : (25, 25) float64
        Projection onto the directions that must not move.
    rate_change : (3,) float64
        Of the body's rate within the sweep [rad/s^2].
    R_first : (3, 3) float64
        Rotation of the map's first pose: what a mounting error did there, it did to the whole map.
    """

    considered: NDArray[np.float64]
    rate_change: NDArray[np.float64]
    R_first: NDArray[np.float64]


def _pose_covariance(prior: NavState, online: Online | None) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of where the LiDAR stands on its map.

    A mounting error shifts pose and map together, so that the pose alone would look far less certain than the match.
    """
    if online is None:
        return prior.covariance[:6, :6]
    B = np.eye(6, len(prior.covariance))
    turn = prior.R_odom_imu.T @ online.R_first
    B[0:3, 17:20] = (np.eye(3) - turn) @ prior.T_imu_lidar[:3, :3]
    B[3:6, 20:23] = prior.R_odom_imu - online.R_first
    return np.asarray(B @ prior.covariance @ B.T)


def _opening(prior: NavState, sigma: float, config: FilterConfig, online: Online | None = None) -> float:
    """Kernel scale of the first iteration: wide enough for what the prediction does not know [m]."""
    covariance = _pose_covariance(prior, online)
    position = float(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[0:3, 0:3])[-1])
    unknown = np.sqrt(max(position, 0.0) + _TYPICAL_RANGE**2 * max(rotation, 0.0))
    return float(np.clip(2.0 * unknown, config.kernel * sigma, config.max_kernel))


def is_vague(prior: NavState, noise: AdaptiveNoise, config: FilterConfig, online: Online | None = None) -> bool:
    """Whether the prediction allows for errors well beyond what the final kernel forgives."""
    return _opening(prior, noise.sigma, config, online) > 3.0 * config.kernel * noise.sigma


def register(
    prior: NavState,
    local_map: LocalMap,
    points_at: Callable[[NavState], NDArray[np.float32]],
    before_end: NDArray[np.float32],
    *,
    T_imu_lidar: NDArray[np.float64],
    noise: AdaptiveNoise,
    config: FilterConfig,
    threads: int,
    online: Online | None = None,
) -> UpdateResult[NormalEquations]:
    """Update ``prior`` with the points of a scan, imu frame at its stamp.

    ``points_at(state)`` gives them de-skewed, (N, 3) float32 [m], ``before_end`` (N,) how long before [s].
    They, and the map, were made with ``T_imu_lidar``; where the state's own mounting differs from it, the residuals are
    corrected to first order. ``online`` is given where mounting and clock are gated states.

    The kernel narrows down to ``config.kernel`` sigmas as the pose settles (graduated non-convexity in its simplest
    form), so that a poor prediction still finds its planes and a good one is not disturbed by wrong ones.
    """
    mounting = len(prior.covariance) > NAV_DIM and bool(prior.covariance[MOUNTING, MOUNTING].any())
    kernel = _NarrowingKernel(_opening(prior, noise.sigma, config, online), config.kernel * noise.sigma)

    def measure(state: NavState, iteration: int) -> NormalEquations:
        scale = kernel.at(state, iteration)
        settings = MatchSettings(
            gate=config.gate * scale,
            kernel=scale,
            sigma=noise.sigma,
            fallback_stride=0 if mounting else config.fallback_stride,
            residual=config.residual,
            mounting=mounting,
            both=online is not None,
            threads=threads,
        )
        equations = linearize(
            local_map, points_at(state), state.T_odom_imu, T_imu_lidar, settings, before_end=before_end
        )
        if mounting:
            off = mounting_error(T_imu_lidar, state.T_imu_lidar)
            equations = replace(equations, gradient=equations.gradient + equations.information[:, -6:] @ off)
        if online is not None:
            equations = with_clock(equations, online.rate_change)
        share = 1.0 / config.correlation
        return replace(
            equations,
            information=share * equations.information,
            gradient=share * equations.gradient,
            weight=share * equations.weight,
        )

    return iterated_update(
        prior,
        measure,
        max_iterations=config.max_iterations + 4 * int(np.ceil(np.log2(kernel.scale / kernel.final))),
        tolerance_rotation=config.tolerance_rotation,
        tolerance_position=config.tolerance_position,
        settled=lambda _: kernel.scale <= kernel.final,
        considered=online.considered if online is not None else None,
    )


def with_clock(equations: NormalEquations, rate_change: NDArray[np.float64]) -> NormalEquations:
    """Add the column of the clock's offset: within the sweep it acts as a gyroscope bias of minus the rates' change."""
    size = len(equations.columns)
    G = np.eye(size, size + 1)
    G[9:12, size] = -rate_change
    return replace(
        equations,
        columns=np.append(equations.columns, CLOCK),
        information=G.T @ equations.information @ G,
        gradient=G.T @ equations.gradient,
    )


class _NarrowingKernel:
    """A kernel's scale that halves each time the pose has settled at the present one, four iterations at the latest."""

    def __init__(self, start: float, final: float) -> None:
        self.scale, self.final = start, final
        self._last: NavState | None = None
        self._stay = 0

    def at(self, state: NavState, iteration: int) -> float:
        """Return the scale [m] for an iteration that begins at ``state``."""
        if iteration > 0 and self._last is not None:
            shift = float(np.linalg.norm(state.p_odom - self._last.p_odom))
            turn = float(np.linalg.norm(state.R_odom_imu - self._last.R_odom_imu)) / np.sqrt(2.0)
            self._stay += 1
            if shift + _TYPICAL_RANGE * turn < 0.5 * self.scale or self._stay >= 4:
                self.scale, self._stay = max(self.final, 0.5 * self.scale), 0
        self._last = state
        return self.scale
