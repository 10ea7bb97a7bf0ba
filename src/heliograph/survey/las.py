"""LAS 1.4 as surveyors take it: coordinates of a system, its WKT, GPS time, intensity.

Every field of the header follows the ASPRS LAS specification 1.4 R15.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.atomic import atomic_path, write_text
from heliograph.errors import DataError, MissingDependencyError
from heliograph.io.files.las import las_writer
from heliograph.survey.coordinates import CoordinateSystem

__all__ = ["adjusted_gps_time", "gps_seconds", "write_survey_las", "write_survey_tiles"]

_INSTALL = "pip install 'heliograph[survey]'"
_LEAP_S = 18.0  # GPS time less UTC, since 2017
_GPS_EPOCH_S = 315_964_800.0  # of GPS time, in seconds since 1970
_ADJUSTED = 1e9  # what adjusted standard GPS time leaves out [s]
_SCALE = 1e-3
_BLOCK = 1_000_000  # points written at once
_GPS_TIME_ADJUSTED, _WKT = 1, 16  # bits of the global encoding


def adjusted_gps_time(stamps_ns: NDArray[np.int64]) -> Array:
    """Return adjusted standard GPS time [s] of UTC stamps [ns]: GPS seconds less a billion."""
    return np.asarray(gps_seconds(stamps_ns) - _ADJUSTED, dtype=np.float64)


def gps_seconds(stamps_ns: NDArray[np.int64]) -> Array:
    """Return GPS time [s], since 6 January 1980, of UTC stamps [ns]."""
    return np.asarray(stamps_ns * 1e-9 + _LEAP_S - _GPS_EPOCH_S, dtype=np.float64)


def write_survey_las(
    path: Path,
    p: Array,
    intensity: NDArray[np.float32] | None,
    stamps_ns: NDArray[np.int64],
    system: CoordinateSystem,
    identifier: str,
) -> None:
    """Write points as LAS or LAZ, point format 6; coordinates to a millimetre about an offset at a whole kilometre.

    Parameters
    ----------
    path : Path
        ``.las`` or ``.laz``.
    p : (N, 3) float64
        In the system, easting first [m].
    intensity : (N,) float32 or None
        0 to 255, or 0 to 1; scaled to 16 bits.
    stamps_ns : (N,) int64
        UTC [ns].
    system : CoordinateSystem
    identifier : str
        What made the points.

    Raises
    ------
    MissingDependencyError
        laspy, or its LAZ back-end, is not installed.
    DataError
        No point, a coordinate that is not finite, or points too far apart for 32 bits.
    """
    laspy = _laspy(path)
    if not len(p) or not np.isfinite(p).all():
        raise DataError(
            f"{path.name}: {len(p)} points, of which {int((~np.isfinite(p)).any(axis=1).sum())} are not finite"
        )
    offset = np.floor(0.5 * (p.min(axis=0) + p.max(axis=0)) / 1000.0) * 1000.0
    if float(np.abs(p - offset).max()) >= _SCALE * 2**31:
        raise DataError(f"{path.name}: points {np.ptp(p, axis=0).max():.0f} m apart do not fit in LAS at a millimetre")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, _SCALE), offset
    header.system_identifier, header.generating_software = identifier[:32], "heliograph"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if system.crs is not None:
        header.add_crs(system.crs)
    sixteen = _sixteen_bits(intensity, len(p))
    with atomic_path(path) as temporary, las_writer(temporary, header) as writer:
        for first in range(0, len(p), _BLOCK):
            part = slice(first, first + _BLOCK)
            record = laspy.ScaleAwarePointRecord.zeros(len(p[part]), header=header)
            record.x, record.y, record.z = p[part].T
            record.intensity, record.gps_time = sixteen[part], adjusted_gps_time(stamps_ns[part])
            record.return_number[:] = 1
            record.number_of_returns[:] = 1
            writer.write_points(record)


def write_survey_tiles(
    folder: Path,
    edge: float,
    p: Array,
    intensity: NDArray[np.float32] | None,
    stamps_ns: NDArray[np.int64],
    system: CoordinateSystem,
    identifier: str,
) -> list[Path]:
    """Write points as LAZ tiles ``<easting>_<northing>.laz``, by their south-west corners, and ``index.json``.

    Parameters
    ----------
    folder : Path
        Made if absent.
    edge : float
        Edge of a tile [m]; corners lie at its multiples.
    p, intensity, stamps_ns, system, identifier
        As `write_survey_las` takes them.

    Returns
    -------
    list of Path
        The tiles, and the index.
    """
    folder.mkdir(exist_ok=True)
    corners, tile_of = np.unique(np.floor(p[:, :2] / edge).astype(np.int64), axis=0, return_inverse=True)
    order, tile_of = np.argsort(tile_of.ravel(), kind="stable"), tile_of.ravel()
    parts = np.split(order, np.searchsorted(tile_of[order], np.arange(1, len(corners))))
    rows = []
    for corner, part in zip((corners * edge).tolist(), parts, strict=True):
        name = f"{corner[0]:.0f}_{corner[1]:.0f}.laz"
        some = None if intensity is None else intensity[part]
        write_survey_las(folder / name, p[part], some, stamps_ns[part], system, identifier)
        rows.append({
            "file": name, "points": len(part), "min": p[part].min(axis=0).tolist(), "max": p[part].max(axis=0).tolist(),
        })  # fmt: skip
    index = {"coordinate_system": system.name, "edge_m": edge, "points": len(p), "tiles": rows}
    write_text(folder / "index.json", json.dumps(index, indent=1) + "\n")
    return [*(folder / row["file"] for row in rows), folder / "index.json"]


def _laspy(path: Path) -> Any:  # noqa: ANN401 - an optional package without types
    try:
        import laspy
    except ImportError as error:
        raise MissingDependencyError(f"writing {path.name} needs laspy: {_INSTALL}") from error
    if path.suffix.lower() == ".laz" and not laspy.LazBackend.detect_available():
        raise MissingDependencyError(f"writing {path.name} needs lazrs: {_INSTALL}")
    return laspy


def _sixteen_bits(intensity: NDArray[np.float32] | None, count: int) -> NDArray[np.uint16]:
    if intensity is None:
        return np.zeros(count, dtype=np.uint16)
    values = np.nan_to_num(intensity.astype(np.float64))
    top = float(values.max(initial=0.0))
    scale = 65535.0 if 0.0 < top <= 1.0 else 257.0 if top <= 255.0 else 1.0
    return np.clip(np.rint(values * scale), 0, 65535).astype(np.uint16)
