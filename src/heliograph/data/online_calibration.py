"""Mounting and clock as the filter estimates them while it runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze

__all__ = ["CALIBRATION_NAMES", "OnlineCalibration"]

CALIBRATION_NAMES = (
    "mounting rotation about imu x",
    "mounting rotation about imu y",
    "mounting rotation about imu z",
    "lever arm along imu x",
    "lever arm along imu y",
    "lever arm along imu z",
    "clock offset",
    "clock drift",
)
_MAIN_SHARE = 0.5  # share of an error's prior variance that lies in directions kept


@dataclass(frozen=True, slots=True, kw_only=True)
class OnlineCalibration:
    """Estimates of mounting and clock, and which directions the motion has not excited enough.

    Parameters
    ----------
    T_imu_lidar : (4, 4) float64
        Mounting [m].
    stamp_ns : int
        When the offset holds, in the LiDAR's clock [ns].
    imu_offset : float
        What the IMU's clock shows more than the LiDAR's, beyond what the reader has corrected already [s].
    imu_drift : float
        Change of the offset with time, likewise [s/s].
    sigma : (8,) float64
        Standard deviations of `CALIBRATION_NAMES` [rad], [m], [s], [s/s]; 0 for what is not estimated.
    gains : (M,) float64
        How many times better than at the start each direction is known by the scans, ascending.
    directions : (8, M) float64
        Those directions as columns, in units of the sigmas at the start, orthonormal.
    kept : (M,) bool
        Directions that keep the value and the sigma of the start; an offset moves on with the drift all the same.
    """

    T_imu_lidar: NDArray[np.float64]
    stamp_ns: int
    imu_offset: float
    imu_drift: float
    sigma: NDArray[np.float64]
    gains: NDArray[np.float64]
    directions: NDArray[np.float64]
    kept: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def kept_names(self) -> tuple[str, ...]:
        """What mostly lies in directions that were kept."""
        share = (self.directions[:, self.kept] ** 2).sum(axis=1)
        return tuple(name for name, s in zip(CALIBRATION_NAMES, share, strict=True) if s > _MAIN_SHARE)

    def summary(self) -> dict[str, object]:
        """Return it as plain values for ``run.json``."""
        return {
            "T_imu_lidar": self.T_imu_lidar.tolist(),
            "reference_ns": self.stamp_ns,
            "imu_offset_s": self.imu_offset,
            "imu_drift_ppm": 1e6 * self.imu_drift,
            "sigma_rotation_rad": self.sigma[:3].tolist(),
            "sigma_lever_arm_m": self.sigma[3:6].tolist(),
            "sigma_imu_offset_s": float(self.sigma[6]),
            "sigma_imu_drift_ppm": 1e6 * float(self.sigma[7]),
            "kept_at_start": list(self.kept_names),
            "directions": [
                {"gain": float(gain), "kept": bool(kept), "in_sigmas_at_start": column.tolist()}
                for gain, kept, column in zip(self.gains, self.kept, self.directions.T, strict=True)
            ],
        }
