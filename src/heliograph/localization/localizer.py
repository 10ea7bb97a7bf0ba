"""Localisation in a saved map, scan by scan, on one page: search while lost, tell rivals apart, track, notice loss."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.config import LocalizationConfig, RunConfig
from heliograph.data import Event, ScanResult
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.localization.changes import ChangeWatch
from heliograph.localization.recent_scans import RecentScans, level_frame
from heliograph.localization.records import Localization, LocalizationState
from heliograph.localization.saved_map import SavedMap
from heliograph.localization.search import MapPlace, Query, search, weigh
from heliograph.localization.tracking import MapTracker, TrackedScan
from heliograph.slam.loops.tangent import near

__all__ = ["Localizer", "decide"]

_CARRIED = 8  # places that are carried from query to query
_REFUTED = 3  # looks in a row, a second or half a metre apart, at which too little fits
_USUAL_PART = 0.8  # share of what the place used to explain below which others are asked
_NOTHING = TrackedScan(matched=float("nan"), nis=float("nan"), contradicts=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Candidate:
    """The one place that fits, since how many queries."""

    T_map_odom: Array
    covariance: Array
    queries: int

    def __post_init__(self) -> None:
        freeze(self)


class Localizer:
    """Finds and tracks an odometry's scans in a saved map; `add` is its page.

    Parameters
    ----------
    saved : SavedMap
    config : RunConfig, optional
    start : (4, 4) float64, optional
        ``T_map_imu`` of the first scan to about a metre and 15 degrees, where it is known: it is looked at first.
    threads : int
        The result does not depend on it.

    Examples
    --------
    >>> localizer = Localizer(saved)
    >>> for message in source:
    ...     for result in odometry.add(message):
    ...         found = localizer.add(result)
    ...         print(found.state, found.T_map_imu)
    """

    def __init__(
        self, saved: SavedMap, config: RunConfig | None = None, *, start: Array | None = None, threads: int = 1
    ) -> None:
        self.saved, self._config, self._threads = saved, config or RunConfig(), threads
        self.events: list[Event] = []
        self.changes = ChangeWatch(saved)
        """What has changed since the map was made, as far as scans have looked while localised."""
        self.queries: list[float] = []
        """Seconds of each global search."""
        self._recent = RecentScans(self._config.localization)
        self._tracker: MapTracker | None = None
        self._candidate: _Candidate | None = None
        self._carried: tuple[Array, ...] = ()  # T_map_odom of places that may be it
        self._state: LocalizationState = "not localised"
        self._places, self._against, self._refuted = 0, 0, 0
        self._usual = 0.0  # share of a scan that the place explained
        self._start = start
        self._seen_through = float("nan")

    def add(self, result: ScanResult) -> Localization:
        """Take the odometry's next result and say where it is in the map."""
        began = time.perf_counter()
        self._seen_through = float("nan")
        if result.matched and len(result.points_imu):
            self._recent.add(result)
        else:
            self._recent.clear()  # odometry does not vouch for the way; hypotheses are told apart by it
            self._candidate = None
        tracked = _NOTHING
        if self._tracker is not None:
            tracked = self._track(result)
        elif result.matched and len(result.points_imu) and self._recent.due(result):
            self._look(result)
        return self._told(result, tracked, time.perf_counter() - began)

    def _look(self, result: ScanResult) -> None:
        """Ask the map for the recent scans, and believe a place when queries in a row find it and no other."""
        began = time.perf_counter()
        T_odom_level = level_frame(result.T_odom_imu)
        try:
            query = Query.of(self._recent.joined(T_odom_level), self.saved, self._config.localization)
        except DataError:  # a few points on a line: nothing to look for
            self._state, self._places, self._candidate = "not localised", 0, None
            return
        if self._start is not None and self._begun_at(query, result):
            return
        known = [T @ T_odom_level for T in self._carried]
        found = search(query, self.saved, self._config.localization, known=known, number=len(self.queries))
        rivals = decide(found, self._config.localization)
        self._carried = tuple(place.T_map_level @ se3.inverse(T_odom_level) for place in rivals[:_CARRIED])
        free = any(not place.held for place in rivals)  # somewhere along what it does not see
        self._places = max(len(rivals), 2) if free else len(rivals)
        self._state = "ambiguous" if self._places > 1 else "not localised"
        self.queries.append(time.perf_counter() - began)
        if self._places != 1:
            self._candidate = None
            return
        self._confirm(rivals[0], T_odom_level, result)

    def _confirm(self, place: MapPlace, T_odom_level: Array, result: ScanResult) -> None:
        told = self._config.localization
        T_map_odom = np.ascontiguousarray(place.T_map_level @ se3.inverse(T_odom_level))
        before = self._candidate
        again = before is not None and near(
            before.T_map_odom @ result.T_odom_imu, T_map_odom @ result.T_odom_imu, told.same, told.same_deg
        )
        queries = 1 + (before.queries if before is not None and again else 0)
        carry = se3.adjoint(se3.inverse(result.T_odom_imu) @ T_odom_level)
        covariance = np.asarray(carry @ place.covariance @ carry.T)
        self._candidate = _Candidate(T_map_odom=T_map_odom, covariance=covariance, queries=queries)
        if queries >= told.agreeing:
            self._lock(result)

    def _begun_at(self, query: Query, result: ScanResult) -> bool:
        """Whether the place that the user gave stands; if not, it is looked for everywhere from now on."""
        assert self._start is not None
        T = level_frame(self._start)
        self._start = None
        place = weigh(query, self.saved.nearest(T), T, self.saved, self._config.localization)
        if place is None or not place.held or not place.stands(self._config.localization):
            share = 0.0 if place is None else place.explained
            text = (
                f"the scans do not fit the map at the start pose ({share:.0%} of them is explained there, "
                f"{self._config.localization.min_explained:.0%} are needed): the whole map is searched instead"
            )
            self.events.append(Event(code="start-pose", message=text, stamp_ns=result.end_ns))
            return False
        T_odom_level = level_frame(result.T_odom_imu)
        carry = se3.adjoint(se3.inverse(result.T_odom_imu) @ T_odom_level)
        self._candidate = _Candidate(
            T_map_odom=np.ascontiguousarray(place.T_map_level @ se3.inverse(T_odom_level)),
            covariance=np.asarray(carry @ place.covariance @ carry.T),
            queries=1,
        )
        self._lock(result)
        return True

    def _lock(self, result: ScanResult) -> None:
        assert self._candidate is not None
        c = self._candidate
        self._tracker = MapTracker(self.saved, self._config, c.T_map_odom, c.covariance, result, threads=self._threads)
        self._state, self._places, self._candidate = "localised", 1, None
        self._against = self._refuted = 0
        self._usual = 0.0
        x, y, z = (c.T_map_odom @ result.T_odom_imu)[:3, 3]
        text = f"found in the map at ({x:.2f}, {y:.2f}, {z:.2f}) m"
        self.events.append(Event(code="localised", message=text, stamp_ns=result.end_ns, severity="info"))

    def _track(self, result: ScanResult) -> TrackedScan:
        """Follow the place; give it up where scans in a row speak against it."""
        assert self._tracker is not None
        told = self._config.localization
        tracked = self._tracker.step(result) if len(result.points_imu) else _NOTHING
        if not tracked.contradicts and self._recent.due(result):
            self._look_closely(result)
        self._against = self._against + 1 if tracked.contradicts else 0
        if self._against >= told.lost_scans or self._refuted >= _REFUTED:
            self._lose(result)
        return tracked

    def _look_closely(self, result: ScanResult) -> None:
        """Weigh the place by the latest scan; where it explains less than it used to, ask whether another fits better.

        A robot that was carried a few metres along an aisle finds surfaces there too, but fewer; a scene that has
        changed explains less as well, but nothing else explains more.
        """
        assert self._tracker is not None
        told, T_map_odom = self._config.localization, self._tracker.T_map_odom
        T_odom_level = level_frame(result.T_odom_imu)
        T = np.ascontiguousarray(T_map_odom @ T_odom_level)
        scan = RecentScans(told)
        scan.add(result)
        try:
            query = Query.of(scan.joined(T_odom_level), self.saved, told)
        except DataError:  # a few points on a line
            self._refuted += 1
            return
        place = weigh(query, self.saved.nearest(T), T, self.saved, told, moves=False)
        assert place is not None
        self._seen_through = place.seen_through
        self.changes.look(T_map_odom @ result.T_odom_imu, scan.latest)
        self._refuted = self._refuted + 1 if place.explained < told.max_unexplained * told.min_explained else 0
        if place.explained >= _USUAL_PART * self._usual:
            self._usual = max(self._usual, place.explained)
            return
        self._usual = place.explained  # it is asked again where it falls further
        found = search(query, self.saved, told, known=[T])
        own = [some for some in found if near(some.T_map_level, T, told.same, told.same_deg)]
        better = [some for some in found if some.stands(told) and some not in own]
        if better and max((some.score for some in own), default=0.0) < told.rival * better[0].score:
            self._refuted = _REFUTED

    def _lose(self, result: ScanResult) -> None:
        assert self._tracker is not None
        self._carried = (self._tracker.T_map_odom,)
        self._tracker, self._state, self._places = None, "not localised", 0
        text = (
            "the scans contradict the place in the map: it is looked for anew - the map ends here, the scene has "
            "changed too much, or the sensor was carried off"
        )
        self.events.append(Event(code="localisation-lost", message=text, stamp_ns=result.end_ns))

    def _told(self, result: ScanResult, tracked: TrackedScan, seconds: float) -> Localization:
        base = Localization(
            stamp_ns=result.end_ns,
            header_stamp_ns=result.header_stamp_ns,
            state=self._state,
            places=self._places,
            T_map_imu=None,
            T_map_imu_header=None,
            T_map_odom=None,
            covariance=None,
            matched=tracked.matched,
            nis=tracked.nis,
            seen_through=self._seen_through,
            seconds=seconds,
        )
        if self._tracker is None:
            return base
        T = self._tracker.T_map_odom
        return replace(
            base,
            T_map_imu=T @ result.T_odom_imu,
            T_map_imu_header=T @ result.T_odom_imu_header,
            T_map_odom=T,
            covariance=self._tracker.covariance,
        )


def decide(found: Sequence[MapPlace], config: LocalizationConfig) -> tuple[MapPlace, ...]:
    """Return the places that may be the right one: the best that stands, and its rivals, which need not stand.

    A place that explains nearly as well and does not stand is a rival: what separates the two is less than what the
    bars are sure to. So is one that a match leaves free along a direction: somewhere along it may be the right one.

    Parameters
    ----------
    found : sequence of MapPlace
        The best first.
    config : LocalizationConfig
    """
    best = next((place for place in found if place.stands(config)), None)
    return () if best is None else tuple(place for place in found if place.score >= config.rival * best.score)
