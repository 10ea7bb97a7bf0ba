"""What localisation says about a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from heliograph.arrays import Array, freeze

__all__ = ["Localization", "LocalizationState"]

LocalizationState: TypeAlias = Literal["localised", "ambiguous", "not localised"]
"""Whether one place of the map is believed, several fit alike, or none does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Localization:
    """Where a scan is in a saved map, as far as it is known.

    Parameters
    ----------
    stamp_ns, header_stamp_ns : int
        End of the scan, and its message's own stamp [ns].
    state : str
        See `LocalizationState`.
    places : int
        Places that fit alike: 1 where it is localised, 0 where none fits.
    T_map_imu, T_map_imu_header : (4, 4) float64 or None
        Pose at either time; None unless it is localised.
    T_map_odom : (4, 4) float64 or None
        Where the odometry's frame lies in the map.
    covariance : (6, 6) float64 or None
        Covariance of ``T_map_imu``, right perturbation [rad^2, m^2], with what the map does not know of itself.
    matched : float
        Share of the scan's points that lie on a surface of the map; NaN where it was not matched.
    nis : float
        Squared correction by the map over what odometry allowed; NaN where it was not matched.
    seen_through : float
        Share of the map's surfaces that the scan should see and looks through, looked at every second; else NaN.
    seconds : float
        What localisation took, without the odometry.
    """

    stamp_ns: int
    header_stamp_ns: int
    state: LocalizationState
    places: int
    T_map_imu: Array | None
    T_map_imu_header: Array | None
    T_map_odom: Array | None
    covariance: Array | None
    matched: float = float("nan")
    nis: float = float("nan")
    seen_through: float = float("nan")
    seconds: float = 0.0

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def sigma(self) -> Array | None:
        """One-sigmas of rotation and position about and along the body's axes (6,) [rad], [m]."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))
