"""The trajectory as SBET and its accuracies as SMRMSG, the binary tables that survey programs exchange.

Both are rows of little-endian doubles without a header. SBET has 17: time of the GPS week [s], latitude, longitude
[rad], height [m], velocity north, east, down [m/s], roll, pitch, heading, wander angle [rad], specific force and
angular rate in the body's axes. SMRMSG has 10: time, one-sigma of position and of velocity north, east, down, of roll,
pitch and heading [arc minutes]. The body is forward, right, down. What a trajectory does not hold is zero: force, and
the sigmas of velocity, roll and pitch.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from heliograph.arrays import Array
from heliograph.atomic import atomic_path
from heliograph.guard.files import TABLE, plain_file
from heliograph.lie import se3, so3
from heliograph.survey.las import gps_seconds
from heliograph.survey.tracks import SurveyTrack

__all__ = ["read_rows", "write_sbet", "write_smrmsg"]

_WEEK_S = 604_800.0
_FRD = np.diag([1.0, -1.0, -1.0])  # forward, right, down from forward, left, up
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # of east, north, up


def write_sbet(path: Path, track: SurveyTrack, origin: Array) -> None:
    """Write a row a pose; angles are about the place's own north, east and down, the wander angle is zero.

    Parameters
    ----------
    path : Path
    track : SurveyTrack
    origin : (3,) float64
        Origin of its east-north-up frame: latitude, longitude [rad], height [m].
    """
    degrees = track.geodetic_deg(origin)
    geodetic = np.column_stack([np.radians(degrees[:, :2]), degrees[:, 2]])
    R_local_enu = _axes(geodetic) @ _axes(origin[None]).transpose(0, 2, 1)
    seconds = 1e-9 * (track.stamps_ns - track.stamps_ns[0])
    velocity, rate = _motion(track, seconds)
    R_ned_frd = _NED @ R_local_enu @ track.T_enu_body[:, :3, :3] @ _FRD
    heading = np.arctan2(R_ned_frd[:, 1, 0], R_ned_frd[:, 0, 0])
    pitch = np.arcsin(np.clip(-R_ned_frd[:, 2, 0], -1.0, 1.0))
    roll = np.arctan2(R_ned_frd[:, 2, 1], R_ned_frd[:, 2, 2])
    nothing = np.zeros(len(seconds))
    rows = [
        _time(track), *geodetic.T, *np.einsum("nij,nj->ni", _NED @ R_local_enu, velocity).T, roll, pitch, heading,
        nothing, nothing, nothing, nothing, *(rate @ _FRD).T,
    ]  # fmt: skip
    _write(path, rows)


def write_smrmsg(path: Path, track: SurveyTrack, origin: Array) -> None:
    """Write the one-sigmas of the same rows; they are along the axes at the origin, which is not looked at."""
    del origin
    east, north, up = track.sigma.T
    nothing = np.zeros(len(east))
    heading = 60.0 * np.degrees(track.sigma_heading)
    _write(path, [_time(track), north, east, up, *[nothing] * 5, heading])


def read_rows(path: Path, columns: int) -> Array:
    """Return the rows (N, columns) of such a file: 17 of an SBET, 10 of an SMRMSG."""
    return np.fromfile(plain_file(path, TABLE), dtype="<f8").reshape(-1, columns)


def _time(track: SurveyTrack) -> Array:
    """Return seconds of the GPS week in which the trajectory begins, which go on beyond its end."""
    seconds = gps_seconds(track.stamps_ns)
    return np.asarray(seconds - _WEEK_S * np.floor(seconds[0] / _WEEK_S))


def _motion(track: SurveyTrack, seconds: Array) -> tuple[Array, Array]:
    """Return velocities in east-north-up and angular rates in the body's axes, (N, 3), by differences of poses."""
    if len(seconds) < 2:
        return np.zeros((len(seconds), 3)), np.zeros((len(seconds), 3))
    velocity = np.gradient(track.T_enu_body[:, :3, 3], seconds, axis=0)
    steps = se3.inverse(track.T_enu_body[:-1]) @ track.T_enu_body[1:]
    rate = so3.log(np.ascontiguousarray(steps[:, :3, :3])) / np.diff(seconds)[:, None]
    return velocity, np.concatenate([rate, rate[-1:]])


def _axes(geodetic: Array) -> Array:
    """Return east, north and up of places (N, 3, 3), as rows, in axes fixed to the Earth."""
    latitude, longitude = geodetic[:, 0], geodetic[:, 1]
    s, c, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    rows = ([-sl, cl, np.zeros_like(s)], [-s * cl, -s * sl, c], [c * cl, c * sl, s])
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def _write(path: Path, columns: list[Array]) -> None:
    with atomic_path(path) as temporary:
        Path(temporary).write_bytes(np.column_stack(columns).astype("<f8").tobytes())
