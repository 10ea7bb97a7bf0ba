"""Attitude, velocity and position of a moving IMU from a few seconds of positions, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import Array, freeze
from heliograph.config import ImuConfig
from heliograph.data import ImuBatch, ImuNoise
from heliograph.errors import DataError
from heliograph.imu.preintegration import preintegrate
from heliograph.lie import ExtendedPose

__all__ = ["PositionStart", "start_from_positions"]


_MIN_POSITIONS = 4  # positions: two give the straight line, and the rest must show more than one direction


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionStart:
    """A start found in motion.

    Parameters
    ----------
    X_world_imu : ExtendedPose
        At the first position.
    rotation_covariance : (3, 3) float64
        Covariance of its rotation about the body's axes [rad^2]: large about an axis that the motion did not show.
    rms_m : float
        How well the positions are met [m].
    """

    X_world_imu: ExtendedPose
    rotation_covariance: Array
    rms_m: float

    def __post_init__(self) -> None:
        freeze(self)


def start_from_positions(
    imu: ImuBatch,
    stamps_ns: ArrayLike,
    p_world: ArrayLike,
    *,
    sigma: float,
    noise: ImuNoise,
    config: ImuConfig | None = None,
    g_world: ArrayLike | None = None,
) -> PositionStart:
    """Find the state at the first of N positions from how the IMU moved between them.

    With preintegrated ``dp_k`` from the first position to the k-th, ``p_k = p + v t_k + g t_k^2 / 2 + R dp_k`` is
    linear in p, v and R. Take a straight line over time out of ``p_k - g t_k^2 / 2`` and of ``dp_k``: what is left of
    the one is what is left of the other turned by R. This is Wahba's problem, solved by a singular value decomposition.
    It needs neither rest nor a guess; heading comes from speeding up, braking and turning. Biases are taken as zero, so
    the positions should span some ten seconds and no more.

    Parameters
    ----------
    imu : ImuBatch
        Covering the positions.
    stamps_ns : (N,) int64
        Stamps of the positions, ascending [ns].
    p_world : (N, 3) float64
        In a world whose gravity is known [m].
    sigma : float
        Standard deviation of a position, an axis [m].
    noise : ImuNoise
        Noise of the IMU.
    config : ImuConfig, optional
        Gaps.
    g_world : (3,) float64, optional
        Gravity; by default down the z axis with the length of the configuration [m/s^2].

    Raises
    ------
    DataError
        Fewer than four positions, or shapes that do not fit.
    """
    config = config or ImuConfig()
    stamps, positions = np.asarray(stamps_ns), np.asarray(p_world, dtype=np.float64)
    if stamps.ndim != 1 or positions.shape != (len(stamps), 3) or len(stamps) < _MIN_POSITIONS:
        raise DataError(
            f"a start in motion needs at least {_MIN_POSITIONS} positions (N, 3) with a stamp each, "
            f"got {stamps.shape} stamps and positions {positions.shape}"
        )
    g = np.array([0.0, 0.0, -config.gravity]) if g_world is None else np.asarray(g_world, dtype=np.float64)
    motion = preintegrate(imu, np.broadcast_to(stamps[0], stamps.shape), stamps, noise=noise, config=config)
    line = np.stack([np.ones(len(stamps)), motion.duration_s], axis=1)
    fit = np.linalg.pinv(line)
    fallen = positions - motion.gravity_s2[:, None] * g
    bent, seen = fallen - line @ (fit @ fallen), motion.delta_p - line @ (fit @ motion.delta_p)
    U, _, Vt = np.linalg.svd(bent.T @ seen)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p, v = fit @ (fallen - motion.delta_p @ R.T)
    off = bent - seen @ R.T
    spread = np.eye(3) * np.einsum("ni,ni->", seen, seen) - seen.T @ seen
    rms = float(np.sqrt(np.mean(off**2)))
    return PositionStart(
        X_world_imu=ExtendedPose.from_rotation_position_velocity(R, p, v),
        # What the motion does not show is as good as any angle: half a turn at most.
        rotation_covariance=np.linalg.inv(spread / max(sigma, rms) ** 2 + np.eye(3) / np.pi**2),
        rms_m=rms,
    )
