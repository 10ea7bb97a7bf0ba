"""Satellite fixes from files beside a recording: NMEA, RTKLIB's .pos, and CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

from heliograph.data import GnssFix
from heliograph.errors import FormatError
from heliograph.geodesy import ecef_to_geodetic
from heliograph.guard.files import TABLE, plain_file
from heliograph.io.files.table import TextTable, read_table

__all__ = ["read_fixes"]

_LEAP_S = 18  # GPS time less UTC, since 2017
_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=timezone.utc)
_NMEA_QUALITY = {1: "single", 2: "sbas", 3: "single", 4: "fixed", 5: "float"}
_RTKLIB_QUALITY = {1: "fixed", 2: "float", 3: "sbas", 4: "sbas", 5: "single", 6: "float"}
_QUALITY_WORDS = {"fix": "fixed", "rtk": "fixed", "dgps": "sbas", "dgnss": "sbas", "gps": "single", "none": ""}
_STAMPS = ("stamp", "stamp_ns", "timestamp", "time", "t", "time_ns", "timestamp_ns")


def read_fixes(path: Path | str, *, near_ns: int = 0) -> list[GnssFix]:
    """Read a file of fixes; its clock is taken to be UTC, GPS time is brought to it.

    Parameters
    ----------
    path : Path or str
        NMEA 0183 (``GGA``, with ``GST`` for sigmas and ``RMC`` or ``ZDA`` for the date), an RTKLIB solution
        (``.pos``), or a CSV with a header: ``stamp`` (seconds or nanoseconds since 1970), ``latitude``, ``longitude``,
        ``height``, and where there are any ``sigma_east``, ``sigma_north``, ``sigma_up`` and ``solution``.
    near_ns : int
        A time of the same day, for an NMEA file without dates [ns].

    Returns
    -------
    list of GnssFix
        In order of their stamps.

    Raises
    ------
    FormatError
        The file cannot be read, is none of these, or holds a value that is no number; the message names the line.
    """
    path = Path(path)
    try:
        text = plain_file(path, TABLE).read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise FormatError(path, f"cannot be read: {error.strerror or error}") from error
    head = next((line for line in text.splitlines() if line.strip()), "")
    if head.startswith(("$", "!")) or "$G" in head[:200]:
        fixes = _nmea(path, text, near_ns)
    elif path.suffix.lower() == ".pos" or head.startswith("%"):
        fixes = _rtklib(path, text)
    else:
        fixes = _csv(path, text)
    if not fixes:
        raise FormatError(
            path, "holds no fix; give NMEA with GGA, an RTKLIB .pos, or a CSV with stamp,latitude,longitude,height"
        )
    return sorted(fixes, key=lambda fix: fix.stamp_ns)


def _fix(
    stamp_ns: int, latitude: float, longitude: float, height: float, solution: str, sigma: Sequence[float] | None
) -> GnssFix:
    covariance = None
    if sigma is not None and len(sigma) == 3 and all(s > 0.0 and math.isfinite(s) for s in sigma):
        covariance = np.diag(np.square(np.asarray(sigma, dtype=np.float64)))
    return GnssFix(
        stamp_ns=stamp_ns,
        received_ns=stamp_ns,
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude=height,
        covariance_enu=covariance,
        valid=bool(solution) and all(map(math.isfinite, (latitude, longitude, height))),
        solution=solution,
    )


def _ns(when: datetime, seconds: float) -> int:
    """Return UTC midnight or another whole second plus ``seconds``, in ns since 1970."""
    whole = math.floor(seconds)
    return int((when + timedelta(seconds=whole)).timestamp()) * 10**9 + round((seconds - whole) * 1e9)


def _nmea(path: Path, text: str, near_ns: int) -> list[GnssFix]:
    fixes: list[GnssFix] = []
    day = (
        datetime.fromtimestamp(near_ns // 10**9, timezone.utc).replace(hour=0, minute=0, second=0) if near_ns else None
    )
    day = _first_date(text) or day
    if day is None:
        raise FormatError(path, "holds times of day without a date (no RMC or ZDA): record one of them too")
    sigmas: dict[str, tuple[float, float, float]] = {}
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(text.splitlines(), 1):
        fields = _sentence(line)
        if not fields:
            continue
        kind = fields[0][-3:]
        if kind == "GST" and len(fields) > 8 and all(fields[6:9]):
            try:
                sigmas[fields[1]] = (float(fields[7]), float(fields[6]), float(fields[8]))
            except ValueError as error:
                raise FormatError(path, f"line {number} is no valid GST sentence ({error})") from error
        elif kind == "GGA" and len(fields) > 11:
            rows.append((number, fields))
    last, days = -1.0, 0
    for number, fields in rows:
        try:
            seconds = _time_of_day(fields[1])
            quality = _NMEA_QUALITY.get(int(fields[6] or 0), "")
            if not quality:
                continue
            latitude, longitude = _degrees(fields[2], fields[3], 2), _degrees(fields[4], fields[5], 3)
            height = float(fields[9]) + float(fields[11] or 0.0)  # above the geoid, and the geoid above the ellipsoid
        except ValueError as error:
            raise FormatError(path, f"line {number} is no valid GGA sentence ({error})") from error
        days += seconds < last - 43200.0  # past midnight
        last = seconds
        stamp_ns = _ns(day + timedelta(days=days), seconds)
        fixes.append(_fix(stamp_ns, latitude, longitude, height, quality, sigmas.get(fields[1])))
    return fixes


def _sentence(line: str) -> list[str]:
    """Return the fields of a sentence whose checksum is right or absent; else nothing."""
    start = line.find("$")
    if start < 0:
        return []
    body, _, checksum = line[start + 1 :].strip().partition("*")
    if checksum:
        total = 0
        for letter in body:
            total ^= ord(letter)
        try:
            if total != int(checksum[:2], 16):
                return []
        except ValueError:
            return []
    return body.split(",")


def _first_date(text: str) -> datetime | None:
    for line in text.splitlines():
        fields = _sentence(line)
        kind = fields[0][-3:] if fields else ""
        try:
            if kind == "ZDA" and len(fields) > 4 and fields[4]:
                return datetime(int(fields[4]), int(fields[3]), int(fields[2]), tzinfo=timezone.utc)
            if kind == "RMC" and len(fields) > 9 and len(fields[9]) == 6:
                d, m, y = (int(fields[9][k : k + 2]) for k in (0, 2, 4))
                return datetime(2000 + y, m, d, tzinfo=timezone.utc)
        except ValueError:
            continue
    return None


def _time_of_day(text: str) -> float:
    return 3600.0 * int(text[:2]) + 60.0 * int(text[2:4]) + float(text[4:])


def _degrees(text: str, side: str, digits: int) -> float:
    value = int(text[:digits]) + float(text[digits:]) / 60.0
    return -value if side in ("S", "W") else value


def _rtklib(path: Path, text: str) -> list[GnssFix]:
    ecef, utc, fixes = False, False, []
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("%"):
            ecef, utc = ecef or "x-ecef" in line, utc or line[1:].split()[:1] == ["UTC"]
            continue
        fields = line.replace(",", " ").split()
        if len(fields) < 6:
            continue
        try:
            when, seconds = _rtklib_time(fields[0], fields[1])
            values = [float(field) for field in fields[2:5]]
            quality = _RTKLIB_QUALITY.get(int(fields[5]), "")
            sigma = [float(field) for field in fields[7:10]]
        except (ValueError, ArithmeticError) as error:
            raise FormatError(path, f"line {number} is no row of an RTKLIB solution ({error})") from error
        stamp_ns = _ns(when, seconds) - (0 if utc else _LEAP_S * 10**9)
        if ecef:
            latitude, longitude, height = ecef_to_geodetic(np.array(values))
            values, sigma = [float(np.degrees(latitude)), float(np.degrees(longitude)), float(height)], 3 * [max(sigma)]
        elif len(sigma) == 3:
            sigma = [sigma[1], sigma[0], sigma[2]]  # the file has north, east, up
        fixes.append(_fix(stamp_ns, values[0], values[1], values[2], quality, sigma))
    return fixes


def _rtklib_time(first: str, second: str) -> tuple[datetime, float]:
    """Return a time and seconds after it, of ``2025/06/15 12:00:00.5`` or of GPS week and seconds."""
    if "/" in first:
        year, month, day = (int(part) for part in first.split("/"))
        h, m, s = second.split(":")
        return datetime(year, month, day, tzinfo=timezone.utc), 3600.0 * int(h) + 60.0 * int(m) + float(s)
    return _GPS_EPOCH + timedelta(weeks=int(first)), float(second)


def _csv(path: Path, text: str) -> list[GnssFix]:
    table = read_table(path, text)
    stamps = table.stamps_ns(*_STAMPS)
    latitude = table.numbers("latitude", "latitude_deg", "lat")
    longitude = table.numbers("longitude", "longitude_deg", "lon", "lng", "long")
    height = table.numbers("height", "height_m", "altitude", "alt", "ellipsoidal_height", "h")
    sigmas = _csv_sigmas(table, len(stamps))
    words = table.words("solution", "quality", "status", "fix") or ["single"] * len(stamps)
    return [
        _fix(int(stamp), float(lat), float(lon), float(h), _solution(word), sigma)
        for stamp, lat, lon, h, word, sigma in zip(stamps, latitude, longitude, height, words, sigmas, strict=True)
    ]


def _csv_sigmas(table: TextTable, count: int) -> list[list[float] | None]:
    named = [table.has(f"sigma_{axis}", f"sigma_{axis}_m", f"std_{axis}") for axis in ("east", "north", "up")]
    if all(named):
        columns = [table.numbers(name) for name in named if name]
        return [[float(column[k]) for column in columns] for k in range(count)]
    level, up = table.has("sigma_h", "sigma", "sigma_m", "hacc"), table.has("sigma_v", "vacc")
    if not level:
        return [None] * count
    across = table.numbers(level)
    vertical = table.numbers(up) if up else 1.5 * across
    return [[float(across[k]), float(across[k]), float(vertical[k])] for k in range(count)]


def _solution(word: str) -> str:
    word = word.strip().lower()
    if word.isdigit():
        return _NMEA_QUALITY.get(int(word), "")
    return _QUALITY_WORDS.get(word, word if word in ("single", "sbas", "float", "fixed") else "single")
