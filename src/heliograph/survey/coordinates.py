"""Coordinate systems through pyproj: by their EPSG code, the UTM zone of a place, or local east-north-up."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.errors import ConfigError, MissingDependencyError
from heliograph.geodesy import enu_to_geodetic, geodetic_to_ecef, geodetic_to_enu

__all__ = ["CoordinateSystem", "find_coordinate_system"]

_INSTALL = "pip install 'heliograph[survey]'"


@dataclass(frozen=True, slots=True, kw_only=True)
class CoordinateSystem:
    """A system that points are delivered in.

    Parameters
    ----------
    name : str
        For people, such as ``EPSG:32632 (WGS 84 / UTM zone 32N)``.
    tag : str
        For file names, such as ``epsg32632``.
    origin : (3,) float64
        Origin of the east-north-up frame: latitude, longitude [rad], height [m].
    crs : object or None
        pyproj's; None for east-north-up itself.
    height : str
        What heights count from.
    """

    name: str
    tag: str
    origin: Array
    crs: Any
    height: str

    def __post_init__(self) -> None:
        freeze(self)

    def from_enu(self, p_enu: Array) -> Array:
        """Return positions (N, 3) float64 in this system, easting first, of positions in east-north-up [m]."""
        if self.crs is None:
            return np.array(p_enu, dtype=np.float64)
        latitude, longitude, height = enu_to_geodetic(np.asarray(p_enu, dtype=np.float64), self.origin).T
        transformer = _pyproj().Transformer.from_crs("EPSG:4979", self.crs, always_xy=True)
        return np.stack(transformer.transform(np.degrees(longitude), np.degrees(latitude), height), axis=-1)

    def to_enu(self, p: Array) -> Array:
        """Invert `from_enu`.

        Raises
        ------
        ConfigError
            A point lies outside of what the system is made for.
        """
        if self.crs is None:
            return np.array(p, dtype=np.float64)
        degrees = self.to_geodetic_deg(p)
        geodetic = np.column_stack([np.radians(degrees[:, :2]), degrees[:, 2]])
        away = np.linalg.norm(geodetic_to_ecef(geodetic) - geodetic_to_ecef(self.origin), axis=-1)
        if (away > 100_000.0).any():
            raise ConfigError(
                f"a point in {self.name} lies {1e-3 * away.max():.0f} km from the run: check the system, the order "
                "(easting first) and the units"
            )
        return geodetic_to_enu(geodetic, self.origin)

    def to_geodetic_deg(self, p: Array) -> Array:
        """Return latitude, longitude [deg] and height above the ellipsoid [m], (N, 3), of positions in this system.

        Raises
        ------
        ConfigError
            A point lies outside of what the system is made for.
        """
        transformer = _pyproj().Transformer.from_crs(self.crs, "EPSG:4979", always_xy=True)
        longitude, latitude, height = transformer.transform(*np.asarray(p, dtype=np.float64).T)
        geodetic = np.stack([latitude, longitude, height], axis=-1)
        if not np.isfinite(geodetic).all():
            bad = p[int(np.flatnonzero(~np.isfinite(geodetic).all(axis=1))[0])]
            raise ConfigError(f"{bad[0]:.2f}, {bad[1]:.2f} is no place in {self.name}: check the order and the units")
        return geodetic


def find_coordinate_system(name: str, origin_deg: Array) -> CoordinateSystem:
    """Return a coordinate system by its name.

    Parameters
    ----------
    name : str
        ``local`` (east-north-up about the run's origin), ``utm`` (the zone of the origin, WGS 84), or what pyproj
        reads: ``EPSG:25832``, ``EPSG:25832+7837``, a WKT.
    origin_deg : (3,) float64
        Latitude and longitude [deg], height above the ellipsoid [m].

    Raises
    ------
    ConfigError
        No such system, it is not in metres, or a grid that its heights need is not installed.
    MissingDependencyError
        pyproj is not installed.
    """
    origin = np.array([*np.radians(origin_deg[:2]), origin_deg[2]])
    if name.lower() == "local":
        return CoordinateSystem(
            name="local east-north-up", tag="local", origin=origin, crs=None, height="the run's origin"
        )
    pyproj = _pyproj()
    if name.lower() == "utm":
        zone = int((origin_deg[1] + 180.0) // 6.0) % 60 + 1
        name = f"EPSG:{(32600 if origin_deg[0] >= 0.0 else 32700) + zone}"
    try:
        crs = pyproj.CRS.from_user_input(int(name) if name.isdigit() else name)
    except pyproj.exceptions.CRSError as error:
        raise ConfigError(
            f"--crs {name} is no coordinate system that pyproj knows; e.g. utm, local, EPSG:25832"
        ) from error
    axes = {axis.unit_name for axis in crs.axis_info}
    if axes - {"metre", "meter", "m"}:
        raise ConfigError(
            f"--crs {name} ({crs.name}) is in {', '.join(sorted(axes))}: choose one in metres, such as utm"
        )
    _require_grids(pyproj, crs, name)
    vertical = next((part.name for part in crs.sub_crs_list if part.is_vertical), "") if crs.is_compound else ""
    return CoordinateSystem(
        name=f"{name} ({crs.name})",
        tag=re.sub(r"[^a-z0-9]+", "", name.lower())[:24],
        origin=origin,
        crs=crs,
        height=vertical or "the ellipsoid",
    )


def _require_grids(pyproj: Any, crs: Any, name: str) -> None:  # noqa: ANN401 - pyproj's own types
    """Refuse a system whose heights would silently stay ellipsoidal for want of a grid."""
    if not crs.is_compound:
        return
    group = pyproj.transformer.TransformerGroup("EPSG:4979", crs, always_xy=True)
    usable = [step for step in group.transformers if "vgridshift" in step.definition or "geoid" in step.definition]
    if not usable:
        missing = [grid.short_name for op in group.unavailable_operations for grid in op.grids if not grid.available]
        need = f": get {missing[0]} (projsync --file {missing[0]})" if missing else ""
        raise ConfigError(
            f"--crs {name} needs a geoid grid that is not installed{need}; without it heights would be wrong"
        )


def _pyproj() -> Any:  # noqa: ANN401 - an optional package without types
    try:
        import pyproj
        import pyproj.transformer
    except ImportError as error:
        raise MissingDependencyError(f"coordinate systems need pyproj: {_INSTALL}; or --crs local") from error
    return pyproj
