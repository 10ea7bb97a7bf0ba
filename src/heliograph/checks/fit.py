"""The closed forms behind the comparisons: the orthogonal matrix between two sensors' turns, and the bias beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.checks.windows import Turns

__all__ = ["TurnFit", "bias_beside", "cross", "fit_turns", "nearest_orthogonal", "without_mean_rate"]


EXCLUSION_CHI_SQUARE = 30.0
"""Chi-square by which one explanation must be worse than the best before it is excluded; 5.5 sigma, because the LiDAR's
errors are not white."""
_TURN_SIGMA = 0.002  # the least that two sensors differ over one window [rad]
_MAX_ROTATION_SIGMA = np.radians(3.0)  # sigma of a rotation that other comparisons may rest on [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnFit:
    """The orthogonal matrix that brings the LiDAR's turns onto the IMU's, and how well it is known.

    Parameters
    ----------
    R_imu_lidar : (3, 3) float64
        The best one, right-handed or not.
    scale, scale_sigma : float
        Length of the IMU's turns over the LiDAR's.
    unit : float
        What one window's difference adds to the cost by chance, overlap counted [rad^2].
    sigma : float
        How far the sensors differ over one window [rad].
    handed : float
        1 or -1 where the turns show which, 0 where they do not.
    determined : bool
        Whether all of the matrix is known, and not only what one axis tells.
    """

    R_imu_lidar: Array
    scale: float
    scale_sigma: float
    unit: float
    sigma: float
    handed: float
    determined: bool

    def __post_init__(self) -> None:
        freeze(self)


def fit_turns(turns: Turns) -> TurnFit | None:
    """Fit ``phi_imu = s R phi_lidar + b span`` over s, b and orthogonal R; None where nothing turns.

    By the singular values ``s_1 >= s_2 >= s_3`` of ``B = sum phi_imu phi_lidar^T`` (G. Wahba, A least squares estimate
    of satellite attitude, 1965): the best fit explains ``(s_1 + s_2 + s_3)^2``, its mirror image at most
    ``(s_1 + s_2 - s_3)^2`` over the LiDAR's energy, and a turn by theta about the best known axis costs
    ``s (s_2 + s_3) theta^2``.
    """
    B, energy_imu, energy_lidar = cross(turns)
    if energy_imu <= 0.0 or energy_lidar <= 0.0:
        return None
    R, values = nearest_orthogonal(B), np.linalg.svd(B, compute_uv=False)
    scale = float(values.sum()) / energy_lidar
    spread = max(energy_imu - scale**2 * energy_lidar, 0.0)
    sigma = max(float(np.sqrt(spread / (3 * len(turns.spans)))), _TURN_SIGMA * max(scale, 1e-3))
    unit = turns.overlap * sigma**2
    mirrored = 4.0 * float((values[0] + values[1]) * values[2]) / energy_lidar
    return TurnFit(
        R_imu_lidar=R,
        scale=scale,
        scale_sigma=float(np.sqrt(unit / energy_lidar)),
        unit=unit,
        sigma=sigma,
        handed=float(np.sign(np.linalg.det(R))) if mirrored > EXCLUSION_CHI_SQUARE * unit else 0.0,
        determined=bool(scale * float(values[1] + values[2]) * _MAX_ROTATION_SIGMA**2 > unit),
    )


def without_mean_rate(turns: Turns, values: Array) -> Array:
    """Return rotation vectors less what a constant rate would have turned in each window."""
    along = turns.spans / float(np.linalg.norm(turns.spans))
    return np.asarray(values - along[:, None] * (along @ values))


def cross(turns: Turns) -> tuple[Array, float, float]:
    """Return ``sum phi_imu phi_lidar^T`` and both energies, a constant rate projected out of either."""
    x, y = without_mean_rate(turns, turns.imu), without_mean_rate(turns, turns.lidar)
    return x.T @ y, float((x**2).sum()), float((y**2).sum())


def nearest_orthogonal(B: Array, *, handed: float = 0.0) -> Array:
    """Return the orthogonal matrix nearest to B; its determinant is ``handed``, or free where that is 0."""
    U, _, Vt = np.linalg.svd(B)
    last = handed * np.sign(np.linalg.det(U @ Vt)) if handed else 1.0
    return np.asarray(U @ np.diag([1.0, 1.0, last]) @ Vt)


def bias_beside(turns: Turns) -> Array:
    """Return the gyroscope's bias beside the best fit, right-handed or not, of any scale, (3,) [rad/s]."""
    fit = fit_turns(turns)
    beside = turns.imu if fit is None else turns.imu - fit.scale * turns.lidar @ fit.R_imu_lidar.T
    return np.asarray(np.median(beside / turns.spans[:, None], axis=0))
