"""How an odometry began, and how well it knew what it began with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze

__all__ = ["StartAccount"]

_UNKNOWN = float("nan")


def _unknown() -> NDArray[np.float64]:
    return np.full(3, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class StartAccount:
    """The start's kind, its verdict, and sigmas of what was found; NaN where the kind of start has none.

    Parameters
    ----------
    kind : str
        ``"static"``, ``"moving"`` or ``"no-imu"``.
    verdict : str
        ``"good"``, ``"fair"`` or ``"poor"``.
    reason : str
        Numbers behind it.
    duration : float
        Data that it rests on [s].
    gravity_sigma : float
        Sigma of the direction of gravity seen from the body, in its worst direction [rad].
    velocity_sigma : float
        Sigma of the velocity in its worst direction [m/s].
    gyro_bias_sigma, accel_bias_sigma : (3,) float64
        [rad/s], [m/s^2].
    accel_scale, accel_scale_sigma : float
        What the accelerometer shows for each m/s^2, where the motion excites it.
    stillness : float
        Largest test of stillness as a share of its limit; below one at rest.
    turned : float
        Largest rotation within the data [rad].
    rate_rms, force_rms : (3,) float64
        Excitation: rate, and specific force about its mean [rad/s], [m/s^2].
    misfit : float
        Squared error of the alignment in units of its variance, 1 or less when all is well.
    unobservable : tuple of str
        What the motion did not excite.
    """

    kind: str
    verdict: str
    reason: str = ""
    duration: float = 0.0
    gravity_sigma: float = _UNKNOWN
    velocity_sigma: float = _UNKNOWN
    gyro_bias_sigma: NDArray[np.float64] = field(default_factory=_unknown)
    accel_bias_sigma: NDArray[np.float64] = field(default_factory=_unknown)
    accel_scale: float = 1.0
    accel_scale_sigma: float = _UNKNOWN
    stillness: float = _UNKNOWN
    turned: float = _UNKNOWN
    rate_rms: NDArray[np.float64] = field(default_factory=_unknown)
    force_rms: NDArray[np.float64] = field(default_factory=_unknown)
    misfit: float = _UNKNOWN
    unobservable: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)
