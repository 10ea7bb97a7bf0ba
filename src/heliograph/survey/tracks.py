"""The way of the body for other programs: CSV with sigmas, GPX, KML."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from heliograph.arrays import Array, Stamps, freeze
from heliograph.atomic import write_text
from heliograph.geodesy import enu_to_geodetic
from heliograph.survey.coordinates import CoordinateSystem

__all__ = ["SurveyTrack", "write_csv_track", "write_gpx_track", "write_kml_track"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyTrack:
    """Poses in east-north-up, with one-sigmas.

    Parameters
    ----------
    stamps_ns : (N,) int64
        [ns].
    T_enu_body : (N, 4, 4) float64
    sigma : (N, 3) float64
        One-sigma of the position, east-north-up [m].
    sigma_heading : (N,) float64
        [rad].
    """

    stamps_ns: Stamps
    T_enu_body: Array
    sigma: Array
    sigma_heading: Array

    def __post_init__(self) -> None:
        freeze(self)

    def geodetic_deg(self, origin: Array) -> Array:
        """Return latitude, longitude [deg] and height [m], (N, 3), about an origin in radians."""
        rows = enu_to_geodetic(self.T_enu_body[:, :3, 3], origin)
        return np.column_stack([np.degrees(rows[:, :2]), rows[:, 2]])


def write_csv_track(path: Path, track: SurveyTrack, system: CoordinateSystem) -> None:
    """Write one row a pose: time, easting, northing, height, heading, pitch, roll, sigmas."""
    p = system.from_enu(track.T_enu_body[:, :3, 3])
    rpy = _rpy(track.T_enu_body[:, :3, :3])
    heading = np.degrees(np.mod(0.5 * np.pi - rpy[:, 2], 2.0 * np.pi))  # clockwise from north
    columns = np.column_stack(
        [p, heading, np.degrees(rpy[:, 1]), np.degrees(rpy[:, 0]), track.sigma, np.degrees(track.sigma_heading)]
    )
    lines = [
        f"# {system.name}; heights above {system.height}; heading clockwise from north; one-sigma",
        "stamp,easting,northing,height,heading_deg,pitch_deg,roll_deg,sigma_east,sigma_north,sigma_up,sigma_heading_deg",
    ]
    for stamp, row in zip(track.stamps_ns.tolist(), columns.tolist(), strict=True):
        metres, angles, sigmas = row[:3], row[3:6], row[6:]
        numbers = [f"{v:.4f}" for v in metres] + [f"{v:.5f}" for v in angles] + [f"{v:.4f}" for v in sigmas]
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d},{','.join(numbers)}")
    write_text(path, "\n".join(lines) + "\n")


def write_gpx_track(path: Path, track: SurveyTrack, origin: Array) -> None:
    """Write GPX 1.1: a point a second, heights above the ellipsoid."""
    body = "".join(
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{h:.3f}</ele><time>{when}</time></trkpt>\n'
        for when, lat, lon, h in _each_second(track, origin)
    )
    write_text(
        path,
        '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="heliograph" '
        f'xmlns="http://www.topografix.com/GPX/1/1"><trk><name>trajectory</name><trkseg>\n{body}</trkseg></trk></gpx>\n',
    )


def write_kml_track(path: Path, track: SurveyTrack, origin: Array) -> None:
    """Write KML 2.2: a line a point a second, heights above the ellipsoid, clamped to the ground for display."""
    places = "".join(f"{lon:.9f},{lat:.9f},{h:.3f}\n" for _, lat, lon, h in _each_second(track, origin))
    worst = float(track.sigma.max(initial=0.0))
    write_text(
        path,
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
        f"<name>trajectory</name><description>one-sigma up to {worst:.3f} m</description><LineString><tessellate>1"
        f"</tessellate><altitudeMode>clampToGround</altitudeMode><coordinates>\n{places}</coordinates></LineString>"
        "</Placemark></Document></kml>\n",
    )


def _each_second(track: SurveyTrack, origin: Array) -> Iterator[tuple[str, float, float, float]]:
    places, last = track.geodetic_deg(origin), -(10**18)
    for stamp, (latitude, longitude, height) in zip(track.stamps_ns.tolist(), places.tolist(), strict=True):
        if stamp - last >= 950_000_000:
            last = stamp
            when = datetime.fromtimestamp(stamp / 1e9, timezone.utc).isoformat(timespec="milliseconds")
            yield when.replace("+00:00", "Z"), latitude, longitude, height


def _rpy(R: Array) -> Array:
    """Return roll, pitch and yaw (N, 3) of ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    return np.stack([np.arctan2(R[:, 2, 1], R[:, 2, 2]), pitch, np.arctan2(R[:, 1, 0], R[:, 0, 0])], axis=-1)
