"""A local east-north-up frame on the WGS-84 ellipsoid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ecef_to_geodetic", "enu_to_geodetic", "geodetic_to_ecef", "geodetic_to_enu"]

_A = 6378137.0  # semi-major axis [m]
_F = 1.0 / 298.257223563  # flattening
_E2 = _F * (2.0 - _F)


def geodetic_to_ecef(geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert (latitude [rad], longitude [rad], height [m]), shape (..., 3), to earth-centred metres."""
    latitude, longitude, height = np.moveaxis(geodetic, -1, 0)
    normal = _A / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
    across = (normal + height) * np.cos(latitude)
    z = (normal * (1.0 - _E2) + height) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=-1)


def ecef_to_geodetic(ecef: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert `geodetic_to_ecef` by fixed-point iteration on the latitude; exact to 1e-12 rad near the ground.

    Notes
    -----
    The classical iteration, e.g. Hofmann-Wellenhof et al., GNSS (2008), section 8.2; a step contracts by 1/300.
    """
    x, y, z = np.moveaxis(ecef, -1, 0)
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - _E2))
    for _ in range(6):
        normal = _A / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + _E2 * normal * np.sin(latitude), across)
    normal = _A / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
    height = across * np.cos(latitude) + z * np.sin(latitude) - normal * (1.0 - _E2 * np.sin(latitude) ** 2)
    return np.stack([latitude, np.arctan2(y, x), height], axis=-1)


def enu_to_geodetic(p_enu: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert positions in a tangent frame to geodetic coordinates.

    Parameters
    ----------
    p_enu : (N, 3) float64
        East, north, up [m].
    origin : (3,) float64
        Latitude [rad], longitude [rad], height [m] of the frame's origin.

    Returns
    -------
    (N, 3) float64
        Latitude [rad], longitude [rad], height [m].
    """
    return ecef_to_geodetic(geodetic_to_ecef(origin) + p_enu @ _axes(origin).T)


def geodetic_to_enu(geodetic: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert `enu_to_geodetic`: coordinates (N, 3) to positions (N, 3) in the tangent frame at ``origin``."""
    return np.asarray((geodetic_to_ecef(geodetic) - geodetic_to_ecef(origin)) @ _axes(origin))


def _axes(origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``R_ecef_enu`` (3, 3) at (latitude, longitude, height)."""
    sin_lat, cos_lat, sin_lon, cos_lon = *_sin_cos(origin[0]), *_sin_cos(origin[1])
    return np.array(
        [
            [-sin_lon, -sin_lat * cos_lon, cos_lat * cos_lon],
            [cos_lon, -sin_lat * sin_lon, cos_lat * sin_lon],
            [0.0, cos_lat, sin_lat],
        ]
    )


def _sin_cos(angle: float) -> tuple[float, float]:
    return float(np.sin(angle)), float(np.cos(angle))
