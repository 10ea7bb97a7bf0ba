"""Satellite fixes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import frozen

__all__ = ["GnssFix"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssFix:
    """One GNSS position.

    Parameters
    ----------
    stamp_ns : int
        Time of validity [ns].
    received_ns : int
        When the recorder got it [ns].
    latitude_deg, longitude_deg : float
        WGS-84 [deg].
    altitude : float
        Height above the ellipsoid [m].
    covariance_enu : (3, 3) float64 or None
        Position covariance, east-north-up [m^2]; None when the receiver gave none.
    valid : bool
        False when the receiver reports no fix.
    frame_id : str
        Name of the antenna frame.
    solution : str
        How the receiver says it came by the position: ``"single"``, ``"sbas"`` (also differential), ``"float"`` or
        ``"fixed"`` (carrier phase, its ambiguities estimated or resolved); empty where it does not say.
    """

    stamp_ns: int
    received_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude: float
    covariance_enu: NDArray[np.float64] | None = None
    valid: bool = True
    frame_id: str = "gnss"
    solution: str = ""

    def __post_init__(self) -> None:
        if self.covariance_enu is not None:
            value = frozen("covariance_enu", self.covariance_enu, np.float64, (3, 3))
            object.__setattr__(self, "covariance_enu", value)
