"""The place of a scan in the map, sought widely after an outage has left the prediction vague.

A narrow search from a vague prediction ends in the nearest place that fits a little. Here the whole region that the
prediction allows is looked at first: how much of the scan lies on planes of the map, at poses on a grid over position
and heading. The best few are registered, and the scan is placed only where one of them matches about as well as scans
did before the outage, and no other place does nearly so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.data import Event, NavState
from heliograph.data.error_layout import POSE, POSITION, ROTATION
from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.maps import LocalMap
from heliograph.odometry.filter.measurement import ScanMeasurement
from heliograph.odometry.filter.update import FilterUpdate
from heliograph.registration import align
from heliograph.snapshots import Stateful, array, fixed

__all__ = ["Relocker", "find_place", "find_place_anywhere", "new_piece"]

_VAGUE_SIGMA = 0.1  # of a predicted position that is sought widely [m]
_SEEK_AT_ONCE, _SEEK_EVERY = 3, 3  # scans that are sought one by one, and from one search to the next after those
_GIVE_UP_NS = 3_000_000_000  # of scans without a place, after which a new piece of map is begun [ns]
_MAX_VAIN, _SEEK_RARELY = 12, 30  # searches without a start that may lead nowhere, and scans between others after that
_MIN_SOUGHT = 5  # of them that were sought
_SILENCE_NS, _SILENT_PERIODS, _PERIOD_GAIN = 300_000_000, 2.5, 0.1  # without a match, before a prediction is astray
_ASTRAY_SIGMA, _ASTRAY_TURN = 0.3, np.radians(5.0)  # of what a narrow search comes home from [m], [rad]
_REMARKED_NS = 300_000_000  # without a place that deserve a remark [ns]

_POINTS = 120  # of a scan that are looked up at each pose
_STEP, _YAW_STEP = 0.5, np.radians(8.0)  # of the grid [m], [rad]
_REACH_SIGMAS, _MAX_REACH, _MAX_RISE = 3.0, 8.0, 1.0  # how far the grid goes: sigmas, metres along and up
_MAX_POSES = 16_000
_MAX_STEP, _MAX_TILT = 0.75, np.radians(6.0)  # a coarser grid, or one that leaves more tilt open, may miss the place
_GATE = 0.35  # of a point to a plane on the grid [m]
_TRIED = 6  # poses that are registered
_START_SIGMA, _START_TURN = 0.4, np.radians(6.0)  # of such a pose [m], [rad]
_USUAL_PART, _RIVAL_PART = 0.85, 0.93  # of the usual matched share that a place needs; of it that no other may reach
_VERIFIED_PART = 0.75  # of the usual matched share where an alignment has verified the place: a sweep de-skewed by a
# velocity that is known to a metre a second matches less, and what is seen now was not all seen before
_MAX_AWAY = 4.0  # sigmas of the prediction within which a place must lie that was found without it
_ELSEWHERE, _TURNED = 0.6, np.radians(12.0)  # apart by more, two places are two [m], [rad]


class Relocker(Stateful):
    """Follows how long scans have found no place, seeks them widely, and gives the map up when that does not help."""

    _STATE: ClassVar = {
        "seeking": bool,
        "_matched_ns": (int, None),
        "_period_ns": float,
        "_since_ns": (int, None),
        "_first_ns": int,
        "_count": int,
        "_last_ns": int,
        "_events": [Event],
        "_vain": [int],
        "_remembered": (fixed(array(np.float32, None, 3), array(np.float64, 4, 4)), None),
    }

    def __init__(self) -> None:
        self.seeking = False
        """Whether the scans since the last match have no place and are sought."""
        self._matched_ns: int | None = None
        self._period_ns = 0.0
        self._since_ns: int | None = None
        self._first_ns = 0
        self._count = 0
        self._last_ns = 0
        self._events: tuple[Event, ...] = ()
        self._remembered: tuple[NDArray[np.float32], Array] | None = None
        self._vain = [0]  # searches anywhere since the last that led somewhere; its copies count along

    def astray(self, prior: NavState, covariance: Array) -> bool:
        """Whether a silence has left the prediction so vague that the place nearest to it may be a wrong one."""
        if self._matched_ns is None:
            return False
        silent = prior.stamp_ns - self._matched_ns > max(_SILENCE_NS, _SILENT_PERIODS * self._period_ns)
        position, turn = (np.linalg.eigvalsh(covariance[part, part])[-1] for part in (POSITION, ROTATION))
        return bool(silent and (position > _ASTRAY_SIGMA**2 or turn > _ASTRAY_TURN**2))

    def sought(
        self,
        prior: NavState,
        covariance: Array,
        local_map: LocalMap,
        points_imu: NDArray[np.float32],
        attempt: Callable[[NavState], FilterUpdate[ScanMeasurement]],
        usual_share: float,
    ) -> FilterUpdate[ScanMeasurement] | None:
        """Return what `find_place` finds where the prediction is vague, at some of the scans; else None."""
        if not _is_vague(covariance) or usual_share == 0.0:
            return None
        self.seeking = True
        self._count += 1
        if self._count > _SEEK_AT_ONCE and self._count % _SEEK_EVERY:
            return None
        poses = _grid(prior, covariance)
        if poses is not None:
            return find_place(prior, poses, local_map, points_imu, attempt, usual_share)
        if self._remembered is None or (self._vain[0] > _MAX_VAIN and self._count % _SEEK_RARELY):
            return None
        self._vain[0] += 1
        return find_place_anywhere(prior, covariance, *self._remembered, points_imu, attempt, usual_share)

    def remember(self, points_imu: NDArray[np.float32], T_odom_imu: Array) -> None:
        """Keep a scan that was matched, with its pose: what is seen after a silence is looked for in the last one."""
        self._remembered = (points_imu, T_odom_imu)

    def told(self, prior: NavState, fit: FilterUpdate[ScanMeasurement] | None) -> bool:
        """Take in whether a scan found its place; True when the map is to be given up for a new one."""
        last_ns, self._last_ns = self._last_ns or prior.stamp_ns, prior.stamp_ns
        if fit is not None:
            away = prior.stamp_ns - (self._matched_ns or prior.stamp_ns)
            if away >= _REMARKED_NS and (self.seeking or self._since_ns is not None):
                moved = float(np.linalg.norm(fit.state.p_odom - prior.p_odom))
                text = (
                    f"after {away * 1e-9:.1f} s without a match the scans were found again in the map, {moved:.2f} m "
                    "from where the motion model had carried them"
                )
                self._events = (*self._events, Event(code="relocked", message=text, stamp_ns=prior.stamp_ns))
            if self._since_ns is None and self._matched_ns is not None:
                step_ns = float(prior.stamp_ns - self._matched_ns)
                self._period_ns += _PERIOD_GAIN * (step_ns - self._period_ns) if self._period_ns else step_ns
            if self.seeking:
                self._vain[0] = 0
            self._matched_ns = prior.stamp_ns
            self._since_ns, self._count, self.seeking = None, 0, False
            return False
        if self._since_ns is None:
            self._since_ns, self._first_ns = last_ns, prior.stamp_ns
        if prior.stamp_ns - self._first_ns < _GIVE_UP_NS or self._count < _MIN_SOUGHT:
            return False
        self._events = (
            *self._events,
            new_piece((prior.stamp_ns - self._since_ns) * 1e-9, prior.covariance, prior.stamp_ns),
        )
        self.begin(prior.stamp_ns)
        return True

    def begin(self, stamp_ns: int) -> None:
        """Begin with a new map, which a scan that ends at the stamp is the first of."""
        self._matched_ns = self._last_ns = stamp_ns
        self._since_ns, self._count, self.seeking = None, 0, False

    def taken_events(self) -> tuple[Event, ...]:
        """Return what has happened since it was asked last."""
        events, self._events = self._events, ()
        return events


def new_piece(seconds: float, covariance: Array, stamp_ns: int) -> Event:
    """Return what is said where the map is given up after so long without a place."""
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[POSITION, POSITION])[-1]))
    text = (
        f"after {seconds:.1f} s no place in the map fits the scans: a new piece of map begins here, known to "
        f"{sigma:.1f} m (1 sigma) against the one before; come back to a place of it to join them by a loop"
    )
    return Event(code="new-piece", message=text, stamp_ns=stamp_ns, severity="error")


def _is_vague(covariance: Array) -> bool:
    return float(np.linalg.eigvalsh(covariance[POSITION, POSITION])[-1]) > _VAGUE_SIGMA**2


def find_place_anywhere(
    prior: NavState,
    covariance: Array,
    points_before: NDArray[np.float32],
    T_odom_before: Array,
    points_imu: NDArray[np.float32],
    attempt: Callable[[NavState], FilterUpdate[ScanMeasurement]],
    usual_share: float,
) -> FilterUpdate[ScanMeasurement] | None:
    """Return the update at a place found by aligning the scan to the last one that had one, whatever the prediction.

    `heliograph.registration.align` accepts a pose without a start only where the evidence leaves no other; the map must
    bear it out like any place.
    """
    try:
        found = align(points_before, points_imu, start="global")
    except DataError:
        return None
    if found.T_target_source is None:
        return None
    T = T_odom_before @ found.T_target_source
    away = T[:3, 3] - prior.p_odom
    if away @ np.linalg.solve(covariance[POSITION, POSITION], away) > _MAX_AWAY**2:
        return None
    fit = attempt(_state_at(prior, T))
    share = fit.measurement.sums.matches / max(fit.measurement.sums.queries, 1)
    return fit if fit.converged and share >= _VERIFIED_PART * usual_share else None


def find_place(
    prior: NavState,
    poses: Array,
    local_map: LocalMap,
    points_imu: NDArray[np.float32],
    attempt: Callable[[NavState], FilterUpdate[ScanMeasurement]],
    usual_share: float,
) -> FilterUpdate[ScanMeasurement] | None:
    """Return the update at the scan's place in the map; None where no place, or more than one, fits.

    Parameters
    ----------
    prior : NavState
        The vague prediction.
    poses : (K, 4, 4) float64
        Those to look at.
    local_map : LocalMap
    points_imu : (N, 3) float32
        Points of the scan as the prediction de-skews them [m].
    attempt : callable
        Registers the scan from a state.
    usual_share : float
        Share of the points that matched in scans before.
    """
    shares = _shares(poses, local_map, points_imu[:: max(1, len(points_imu) // _POINTS)])
    found: list[tuple[float, FilterUpdate[ScanMeasurement]]] = []
    for k in _distinct(poses, shares):
        fit = attempt(_state_at(prior, poses[k]))
        share = fit.measurement.sums.matches / max(fit.measurement.sums.queries, 1)
        found.append((share, fit))
    best_share, best = max(found, key=lambda item: (item[1].converged, item[0]))
    if not best.converged:
        return None
    rivals = [share for share, fit in found if _apart(fit.state, best.state) and share > _RIVAL_PART * best_share]
    return best if best_share >= _USUAL_PART * usual_share and not rivals else None


def _grid(prior: NavState, covariance: Array) -> Array | None:
    """Return poses (K, 4, 4) over what the prediction allows of position and heading, the prediction among them.

    None where that is more than can be looked at: the best of a part may be a wrong place that looks like the right.
    """
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[POSITION, POSITION])[-1], 0.0))
    up = np.array([0.0, 0.0, 1.0]) if not prior.g_odom.any() else -prior.g_odom / np.linalg.norm(prior.g_odom)
    along = prior.R_odom_imu.T @ up
    turn = float(np.sqrt(max(along @ covariance[ROTATION, ROTATION] @ along, 0.0)))
    across = np.eye(3) - np.outer(along, along)
    tilt = float(np.sqrt(max(np.linalg.eigvalsh(across @ covariance[ROTATION, ROTATION] @ across)[-1], 0.0)))
    reach = max(_REACH_SIGMAS * float(sigma), 2 * _STEP)
    if reach > _MAX_REACH or tilt > _MAX_TILT:
        return None
    yaws = _steps(min(_REACH_SIGMAS * turn, np.pi), _YAW_STEP)
    rises = _steps(min(_REACH_SIGMAS * float(np.sqrt(covariance[5, 5])), _MAX_RISE), _STEP)
    step = _STEP
    while (2 * reach / step + 1) ** 2 * len(yaws) * len(rises) > _MAX_POSES:
        step *= 1.25
    if step > _MAX_STEP:
        return None
    ways = _steps(reach, step)
    x, y, z, yaw = (values.ravel() for values in np.meshgrid(ways, ways, rises, yaws, indexing="ij"))
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, :3, :3] = so3.exp(yaw[:, None] * up) @ prior.R_odom_imu
    poses[:, :3, 3] = prior.p_odom + np.stack([x, y, z], axis=1)
    return poses


def _steps(reach: float, step: float) -> Array:
    count = int(np.ceil(reach / step)) if reach > 0.5 * step else 0
    return step * np.arange(-count, count + 1, dtype=np.float64)


def _shares(poses: Array, local_map: LocalMap, points: NDArray[np.float32]) -> Array:
    """Return the share of the points that lie on a plane of the map at each pose, (K,)."""
    shares = np.empty(len(poses))
    for begin in range(0, len(poses), 200):
        part = poses[begin : begin + 200]
        at = points.astype(np.float64) @ np.swapaxes(part[:, :3, :3], -1, -2) + part[:, None, :3, 3]
        found = local_map.planes_at(np.ascontiguousarray(at.reshape(-1, 3)), gate=_GATE)
        off = np.abs(np.einsum("ij,ij->i", found.normal, at.reshape(-1, 3) - found.point))
        hit = (found.source > 0) & (off < _GATE)
        shares[begin : begin + 200] = hit.reshape(len(part), -1).mean(axis=1)
    return shares


def _distinct(poses: Array, shares: Array) -> list[int]:
    """Return the best poses that are no neighbours of a better one."""
    chosen: list[int] = []
    for k in np.argsort(-shares, kind="stable"):
        near = [
            j
            for j in chosen
            if np.linalg.norm(poses[k, :3, 3] - poses[j, :3, 3]) < 1.5 * _STEP
            and np.trace(poses[k, :3, :3].T @ poses[j, :3, :3]) > 1.0 + 2.0 * np.cos(2.0 * _YAW_STEP)
        ]
        if not near:
            chosen.append(int(k))
        if len(chosen) >= _TRIED:
            break
    return chosen


def _state_at(prior: NavState, T: Array) -> NavState:
    """Return the prediction moved to a pose of the grid, as sure of it as the grid is fine."""
    R = T[:3, :3] @ prior.R_odom_imu.T
    covariance = prior.covariance.copy()
    covariance[POSE, :] = 0.0
    covariance[:, POSE] = 0.0
    covariance[POSE, POSE] = np.diag(np.repeat([_START_TURN, _START_SIGMA], 3) ** 2)
    return replace(prior, R_odom_imu=T[:3, :3], p_odom=T[:3, 3].copy(), v_odom=R @ prior.v_odom, covariance=covariance)


def _apart(a: NavState, b: NavState) -> bool:
    turn = float(np.linalg.norm(so3.log(a.R_odom_imu.T @ b.R_odom_imu)))
    return float(np.linalg.norm(a.p_odom - b.p_odom)) > _ELSEWHERE or turn > _TURNED
