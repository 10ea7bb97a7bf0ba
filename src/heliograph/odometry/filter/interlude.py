"""Scans that found no place after an outage: they wait for one that does, and are placed from there.

The first scans after a silence come with a prediction that is metres and degrees off. When one of the next is found in
the map, velocity and attitude are known again, and the inertial samples lead back from it to those before: they are
matched where they were and not where the prediction had carried them. Where none is found and a new piece of map
begins, it begins with the first of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from heliograph.data import Event, ScanResult
from heliograph.odometry.filter.core import CoreMark, FilterCore
from heliograph.odometry.filter.relocking import new_piece
from heliograph.odometry.sequencer import ImuBuffer, Packet

__all__ = ["Interlude"]

_MAX_HELD = 60  # scans that may wait
_USUAL_PART, _MIN_FITTING = 0.85, 0.6  # of the usual share of matches, for a scan to fit; of those before that must
_LONGEST_STEP = 5.0  # usual steps of the IMU, beyond which it was silent


@dataclass(frozen=True, slots=True)
class _Held:
    """A scan without a place: where the filter was before it, and what it made of it."""

    mark: CoreMark
    packet: Packet
    result: ScanResult


class Interlude:
    """Holds the results of scans without a place back until one is found.

    Parameters
    ----------
    imu : ImuBuffer
        Samples; none of an interlude that lasts may be forgotten.
    """

    def __init__(self, imu: ImuBuffer) -> None:
        self._imu = imu
        self._held: list[_Held] = []

    @property
    def lasts(self) -> bool:
        """Whether scans wait."""
        return bool(self._held)

    def stepped(self, packet: Packet, core: object, step: Callable[[Packet], ScanResult]) -> list[ScanResult]:
        """Take a step and return the results that are ready: none while scans wait for a place."""
        if not isinstance(core, FilterCore):
            return [step(packet)]
        mark = core.mark()
        result = step(packet)
        if core.seeking:
            self._held.append(_Held(mark, packet, result))
            return self.ended(core, step) if len(self._held) >= _MAX_HELD else []
        if not self._held:
            return [result]
        # Until it is decided they wait on: a place may be refused, and the next one leads back by the same samples.
        held = self._held
        results = self._revisited(held, packet, result, mark, core, step)
        if self._held is held:
            self._held = []
        return results

    def ended(self, core: object, step: Callable[[Packet], ScanResult]) -> list[ScanResult]:
        """Return the results of the scans that wait when no others come: those of a new piece of map."""
        held, self._held = self._held, []
        if not held or not isinstance(core, FilterCore):
            return []
        silent = (held[-1].packet.end_ns - held[0].mark.state.stamp_ns) * 1e-9
        event = new_piece(silent, held[-1].result.covariance, held[-1].packet.end_ns)
        first = self._first_covered(held, held[-1].packet)
        before, again = [scan.result for scan in held[:first]], held[first:]
        if again:
            self._begin_anew(again[0], held[-1].packet, core)
            placed = [step(scan.packet) for scan in again]
            before += _with_events(placed, [scan.result.events for scan in again])
        return [*before[:-1], replace(before[-1], events=(*before[-1].events, event))]

    def _revisited(
        self,
        held: list[_Held],
        packet: Packet,
        result: ScanResult,
        before_it: CoreMark,
        core: FilterCore,
        step: Callable[[Packet], ScanResult],
    ) -> list[ScanResult]:
        """Place the scans that waited behind the one that was found, or begin the new piece of map with them."""
        first = self._first_covered(held, packet)
        before, again = [scan.result for scan in held[:first]], held[first:]
        if not again:
            return [*before, result]
        if not result.matched:
            self._begin_anew(again[0], packet, core)
            placed = [step(scan.packet) for scan in again] + [step(packet)]
            return [*before, *_with_events(placed, [*(scan.result.events for scan in again), result.events])]
        after = core.mark()
        placed = self._placed(again, packet, core, step)
        if _bears_out(placed, self._covered_since(packet.end_ns), core.usual_share):
            core.come_back(after)
            return [*before, *_with_events(placed, [scan.result.events for scan in again]), result]
        return self._refused(held, packet, before_it, core, step)

    def _begin_anew(self, first: _Held, last: Packet, core: FilterCore) -> None:
        begin_ns = _begin_ns(first)
        imu = self._imu.between(first.mark.state.stamp_ns, last.end_ns)
        core.begin_anew(first.mark, imu, begin_ns, last.end_ns)

    def _placed(
        self, again: list[_Held], packet: Packet, core: FilterCore, step: Callable[[Packet], ScanResult]
    ) -> list[ScanResult]:
        """Return the results of scans that waited, as they come from where the scan of ``packet`` was found."""
        first = again[0]
        begin_ns = _begin_ns(first)
        core.step_back(self._imu.between(begin_ns, packet.end_ns), begin_ns, first.mark.count)
        core.holds_map = True
        try:
            return [step(scan.packet) for scan in again]
        finally:
            core.holds_map = False

    def _refused(
        self,
        held: list[_Held],
        packet: Packet,
        mark: CoreMark,
        core: FilterCore,
        step: Callable[[Packet], ScanResult],
    ) -> list[ScanResult]:
        """Take back a place that the scans before contradict: the scan waits like them."""
        core.come_back(mark)
        core.blindfolded = True
        try:
            result = step(packet)
        finally:
            core.blindfolded = False
        self._held = [*held, _Held(mark, packet, result)]
        return [] if core.seeking and len(self._held) < _MAX_HELD else self.ended(core, step)

    def _first_covered(self, held: list[_Held], last: Packet) -> int:
        """Return the first scan from whose end on the inertial samples run on without a break."""
        since_ns = self._covered_since(last.end_ns)
        return next((k for k, scan in enumerate(held) if scan.packet.end_ns > since_ns), len(held))

    def _covered_since(self, end_ns: int) -> int:
        """Return from when on the inertial samples run up to a stamp without a break [ns]."""
        stamps = self._imu.everything().stamps_ns
        stamps = stamps[: int(np.searchsorted(stamps, end_ns)) + 1]
        breaks = np.flatnonzero(np.diff(stamps) > _LONGEST_STEP * self._imu.period_ns)
        return int(stamps[breaks[-1] + 1]) if len(breaks) else np.iinfo(np.int64).min


def _begin_ns(held: _Held) -> int:
    """Return where the sweep of a scan begins [ns]."""
    return held.mark.state.stamp_ns if held.packet.scan is None else held.packet.scan.stamp_ns


def _bears_out(placed: list[ScanResult], since_ns: int, usual_share: float) -> bool:
    """Whether scans before the one that was found fit the map as well, where the samples lead back to them."""
    covered = [result for result in placed if result.stamp_ns >= since_ns]
    fits = [r.matched and r.matches >= _USUAL_PART * usual_share * r.queries for r in covered]
    return not fits or sum(fits) >= _MIN_FITTING * len(fits)


def _with_events(results: list[ScanResult], events: list[tuple[Event, ...]]) -> list[ScanResult]:
    """Return results with what was said when their scans came first, once each."""
    merged = []
    for result, said in zip(results, events, strict=True):
        codes = {event.code for event in result.events}
        merged.append(replace(result, events=(*result.events, *(e for e in said if e.code not in codes))))
    return merged
