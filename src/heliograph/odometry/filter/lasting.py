"""Errors that scans after one another share, and how fast the map's frame takes them over.

A match is not wrong by the noise of its points alone. A plane laid through the step of a door frame leans, and what is
seen of it from near differs from what was seen of it from afar: it pulls the pose the same way in every scan, and like
frames farther on pull that way too. Scans at their true poses, held against a map of true poses, show it: however many
are averaged, an error stays, and in corridors, rooms and halls alike it is what follows if a sixth of the scatter about
a plane is shared by all that is seen of it and of its neighbours in a cube of half a metre.

So what lasts is considered (S. Schmidt, 1966), never estimated: a pull ``c = L beta`` with ``L L^T`` the covariance
that such shared errors give a match (K.-Y. Liang, S. Zeger, "Longitudinal data analysis using generalized linear
models", 1986, clusters of matches in place of subjects), and ``beta`` of unit variance, forgotten over the way that a
scan sees. That it pulls along the way, and so undoes on the way back what it did before, is not credited. The map's
frame follows it as fast as its planes are replaced. Be ``w_k n_k n_k^T`` the information of the planes matched and
``a_k`` the way gone since their points came in: a pose that is off by c from where the planes were laid, which is where
poses were then, leads the frame away by

    (sum w_k a_k n_k n_k^T)^-1 (sum w_k n_k n_k^T) c

a metre. In a hall that was seen long ago that is next to nothing. In a corridor what tells the place along it has come
into view a few metres before: there the frame slides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.data import NavState
from heliograph.data.error_layout import POSE_DIM, POSITION, ROTATION
from heliograph.maps import LocalMap, VoxelMap
from heliograph.registration import MatchSettings, TrueShare
from heliograph.snapshots import Stateful, array

__all__ = ["Drag", "LastingErrors", "MatchedPoints"]

_STRIDE = 0.5  # ages are looked at so often, and a plane is no younger [m]
_ASKED = 1000  # points whose planes are asked
_CUBE = 0.5  # edge of the cubes whose planes err alike [m]
_SHARED = 1.0 / 6.0  # share of the scatter about a plane that all matches in its cube have in common
_BOTH = 2.0  # the planes were laid by scans that were pulled as this one is, at another place
_LEAST = 1e-9  # information along an axis by that of the best, below which nothing is said of its age


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedPoints:
    """What a scan was matched with: its points (N, 3) float32 in the imu frame at its end [m], and how."""

    points_imu: NDArray[np.float32]
    settings: MatchSettings

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drag:
    """How the map's frame followed what lasts over a stride.

    Parameters
    ----------
    gain : (3, 3) float64
        How far the frame was led away, odom axes, by unit errors of what lasts [m].
    kept : float
        Share of those errors that goes on after it.
    """

    gain: Array
    kept: float

    def __post_init__(self) -> None:
        freeze(self)


class LastingErrors(Stateful):
    """Counts the way and the scans inserted along it, and tells what drags the frame.

    Parameters
    ----------
    reach : float
        Way over which surfaces are alike, and pull alike [m].
    """

    _STATE: ClassVar = {
        "_way": float,
        "_at": (array(np.float64, 3), None),
        "_scans": int,
        "_marks": array(np.float64, None, 2),
        "_count": int,
    }

    def __init__(self, reach: float) -> None:
        self._reach = reach
        self._way = 0.0
        self.begin()

    def begin(self) -> None:
        """Begin anew: the map was cleared."""
        self._at: Array | None = None
        self._scans = 0
        self._marks = np.zeros((64, 2))  # number of the last scan inserted before a stride ended, and the way by then
        self._count = 1

    def dragged(
        self, local_map: object, state: NavState, seen: TrueShare | None, matched: MatchedPoints | None
    ) -> Drag | None:
        """Take in a scan that is about to be inserted; None where no stride ended, or nothing tells the planes' ages.

        Parameters
        ----------
        local_map : LocalMap
            As it was matched; any other kind tells no ages.
        state : NavState
            At the scan's end.
        seen : TrueShare or None
            What the match saw of the pose.
        matched : MatchedPoints or None
        """
        self._scans += 1
        if self._at is None:
            self._at = state.p_odom
            self._marks[0] = 0.0, self._way
        stride = float(np.linalg.norm(state.p_odom - self._at))
        if stride < _STRIDE:
            return None
        self._way, self._at = self._way + stride, state.p_odom
        drag = None
        if seen is not None and matched is not None and isinstance(local_map, LocalMap):
            drag = self._drag(local_map, state, seen, matched, stride)
        self._mark()
        return drag

    def _mark(self) -> None:
        if self._count == len(self._marks) or not self._marks.flags.writeable:  # full, or taken up from a checkpoint
            self._marks = np.concatenate([self._marks, np.zeros_like(self._marks)])
        self._marks[self._count] = self._scans - 1, self._way
        self._count += 1

    def _ages(self, since: Array) -> Array:
        """Return the way gone since scans of these numbers (1 is the first) were inserted [m]."""
        k = np.searchsorted(self._marks[: self._count, 0], since, side="left") - 1
        return np.asarray(self._way - self._marks[np.maximum(k, 0), 1])

    def _drag(
        self, local_map: LocalMap, state: NavState, seen: TrueShare, matched: MatchedPoints, stride: float
    ) -> Drag | None:
        told = _told(local_map, state, matched)
        if told is None:
            return None
        values, axes = np.linalg.eigh(_BOTH * seen.spread(told.shared())[POSITION, POSITION])
        pull = (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
        n, age = told.J[:, POSITION], np.maximum(self._ages(told.since), _STRIDE)
        whole, aged = ((n * (told.w * a)[:, None]).T @ n for a in (np.ones(len(age)), age))
        floor = _LEAST * float(np.trace(whole)) * np.eye(3)
        gain = stride * np.linalg.solve(aged + _STRIDE * floor, (whole + floor) @ pull)
        return Drag(gain=gain, kept=float(np.exp(-stride / self._reach)))


@dataclass(frozen=True, slots=True)
class _Told:
    """Planes that tell their age: rows J (M, 6), weights, places, scatter, ages; one in ``stride`` points asked."""

    J: Array
    w: Array
    at: Array
    scatter: Array
    since: Array
    stride: int

    def __post_init__(self) -> None:
        freeze(self)

    def shared(self) -> Array:
        """Return the covariance (6, 6) of the score that errors shared within a cube make."""
        keys = np.floor(self.at / _CUBE).astype(np.int64) @ np.array([1 << 42, 1 << 21, 1])
        order = np.argsort(keys, kind="stable")
        begins = np.flatnonzero(np.diff(keys[order], prepend=keys[order[0]] - 1))
        scores = (self.J * (self.w * np.sqrt(_SHARED * self.scatter))[:, None])[order]
        cubes = np.add.reduceat(scores, begins)
        # One in `stride` was asked: of each with itself there are as many times more, of pairs that many squared.
        own = scores.T @ scores
        return np.asarray(self.stride**2 * (cubes.T @ cubes - own) + self.stride * own)


def _told(local_map: LocalMap, state: NavState, matched: MatchedPoints) -> _Told | None:
    stride = max(1, len(matched.points_imu) // _ASKED)
    p, settings = matched.points_imu[::stride].astype(np.float64), matched.settings
    at = p @ state.R_odom_imu.T + state.p_odom
    if isinstance(local_map, VoxelMap):
        found = local_map.planes_at(at, gate=settings.gate, neighbours=False)
    else:
        found = local_map.planes_at(at, gate=settings.gate)
    if found.since is None or found.scatter is None:
        return None
    some = (found.source > 0) & (found.since > 0.0) & (found.scatter >= 0.0)
    if not some.any():
        return None
    n, at = found.normal[some].astype(np.float64), at[some]
    r = np.einsum("ij,ij->i", n, at - found.point[some])
    w = (settings.kernel**2 / (settings.kernel**2 + r * r)) ** 2 / (settings.sigma**2 + found.variance[some])
    J = np.zeros((len(n), POSE_DIM))
    J[:, ROTATION], J[:, POSITION] = np.cross(p[some], n @ state.R_odom_imu), n
    scatter, since = found.scatter[some].astype(np.float64), found.since[some].astype(np.float64)
    return _Told(J=J, w=w, at=at, scatter=scatter, since=since, stride=stride)
