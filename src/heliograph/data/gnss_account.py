"""What became of the satellite fixes of a run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze, frozen
from heliograph.data.error_layout import ROTATION

__all__ = ["Georeference", "GnssAccount", "JudgedFix"]


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedFix:
    """One fix, and what was made of it.

    Parameters
    ----------
    stamp_ns : int
        As the receiver stamped it [ns].
    solution : str
        As in `GnssFix`.
    geodetic_deg : (3,) float64
        Latitude and longitude [deg], height above the ellipsoid [m].
    p_enu : (3,) float64
        The same about the run's origin [m]; NaN without a fix.
    sigma_enu : (3,) float64
        One-sigma that it is weighed with: the reported one, at least the floor, scaled by what was found [m].
    residual_enu : (3,) float64
        Estimated antenna less fix [m]; NaN where it was not compared.
    weight : float
        0 (not used) to 1.
    decision : str
        ``"used"``, ``"rejected"``, ``"unusable"`` or ``"not compared"``.
    reason : str
        In words, with numbers.
    """

    stamp_ns: int
    solution: str
    geodetic_deg: NDArray[np.float64]
    p_enu: NDArray[np.float64]
    sigma_enu: NDArray[np.float64]
    residual_enu: NDArray[np.float64]
    weight: float
    decision: str
    reason: str

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Georeference:
    """Where the map lies on Earth.

    Parameters
    ----------
    origin_deg : (3,) float64
        Origin of the east-north-up frame: latitude, longitude [deg], height above the WGS-84 ellipsoid [m].
    T_map_enu : (4, 4) float64
        ``p_map = T_map_enu @ p_enu`` [m].
    covariance : (6, 6) float64
        That of a right perturbation of it: rotation [rad^2], origin [m^2].
    """

    origin_deg: NDArray[np.float64]
    T_map_enu: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, shape in (("origin_deg", (3,)), ("T_map_enu", (4, 4)), ("covariance", (6, 6))):
            object.__setattr__(self, name, frozen(name, getattr(self, name), np.float64, shape, finite=True))

    @property
    def T_enu_map(self) -> NDArray[np.float64]:
        """The inverse of `T_map_enu`, (4, 4)."""
        R, t = self.T_map_enu[:3, :3], self.T_map_enu[:3, 3]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R.T, -R.T @ t
        return T

    @property
    def heading_sigma(self) -> float:
        """One-sigma of the heading [rad]."""
        up = self.T_map_enu[:3, :3].T[:, 2]
        return float(np.sqrt(max(up @ self.covariance[ROTATION, ROTATION] @ up, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssAccount:
    """The fixes of a run, and what they told.

    Parameters
    ----------
    fixes : tuple of JudgedFix
        In order of their stamps.
    georeference : Georeference or None
        None: the map could not be placed on Earth.
    reason : str
        Why not.
    lever_arm : (3,) float64
        The antenna in the imu frame that was used [m].
    lever_arm_sigma : (3,) float64
        Zero where it was given [m].
    delay, delay_sigma : float
        How much later than the truth the fixes are stamped [s]; sigma NaN where it was not told.
    noise_scale : float
        What the reported sigmas were multiplied with, the largest over the kinds of solutions.
    odometry_scale : float
        What the odometry's sigmas were multiplied with so that it agrees with the fixes.
    """

    fixes: tuple[JudgedFix, ...]
    georeference: Georeference | None
    reason: str
    lever_arm: NDArray[np.float64]
    lever_arm_sigma: NDArray[np.float64]
    delay: float
    delay_sigma: float
    noise_scale: float
    odometry_scale: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def counts(self) -> dict[str, int]:
        """Decision -> how many."""
        return dict(Counter(fix.decision for fix in self.fixes))
