"""What a run amounted to, and how far it is to be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import freeze
from heliograph.checks import Finding
from heliograph.data import Event, GraphAccount, Rig, ScanResult, SensorRepair, StartAccount
from heliograph.data.error_layout import GRAVITY
from heliograph.output.blind_spans import BlindSpan, BlindSpans
from heliograph.output.final_poses import FinalPoses
from heliograph.output.level import Level
from heliograph.output.reasons import Reason
from heliograph.snapshots import PART, Stateful, array, fixed

__all__ = ["RunSummary", "Tally", "doubts_of", "fold_events", "judge"]

# Shares of the scans from which a result is called degraded or lost. A single bad scan in a thousand is normal (a
# person walks past the sensor); from a tenth on a user who trusts the map without looking would be misled.
DEGRADED_SHARE = 0.10
HELD_SHARE = 0.2
LOST_SHARE = 0.10
UNTRACKED_SHARE = 0.50


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """The account of one run.

    Parameters
    ----------
    status : str
        ``"ok"``, ``"degraded"`` or ``"lost"``.
    reasons : tuple of str
        Why it is not ``"ok"``, with numbers.
    interrupted : bool
        True when Ctrl-C ended it before the recording did.
    sensors : tuple of str
        Sensors that the estimate rests on, of ``"lidar"`` and ``"imu"``.
    scans : int
        Results produced.
    statuses : mapping
        Scan status -> how many.
    distance : float
        Length of the path at the scans' ends [m].
    duration : float
        From the first scan's end to the last one's [s].
    start_end_gap : float
        Distance between the first and the last position [m].
    weakest_eigenvalue : float
        Smallest eigenvalue of any scan's per-measurement translation information, NaN if no scan was matched.
    weakest_direction : (3,) float64
        Its direction, map frame, unit length.
    weakest_index : int
        The scan where it occurred; -1 if none.
    blind_spans : tuple of BlindSpan
        Stretches along which one direction was not seen, in order.
    wall_seconds : float
        From opening the recording to the last result [s].
    seconds : mapping
        Where those went: ``"opening"``, ``"reading"``, ``"odometry"``, ``"writing"`` [s]. Where a second thread reads
        ahead, ``"reading"`` is the waiting only.
    stage_ms : mapping
        The odometry's own stages -> mean milliseconds a scan.
    events : tuple of Event
        Warnings of the recording and of the odometry, repeats folded.
    T_map_odom : (4, 4) float64
        Applied to every written pose and map point: the odometry's last word on which way is up.
    final_poses : FinalPoses or None
        Poses of keyframes that a back-end moved; then they take the place of ``T_map_odom``, but for the file of the
        odom frame. None where nothing was moved.
    graph : GraphAccount or None
        What the back-end made of the run; None where there was none.
    level : Level
        How well it is known which way is up, at the end and so for the whole run.
    start : StartAccount or None
        How the odometry began; None where it does not tell.
    failure : str
        The error that ended the run early, or empty.
    findings : tuple of Finding
        The six verdicts of the checks inside the run.
    repairs : tuple of SensorRepair
        What was mended before the run.
    rig : Rig or None
        Mounting and clock that the run used; None where it has only one sensor.
    resumed : tuple of int
        Scans that were done each time that the run was resumed after it had been cut off.
    """

    status: str = "ok"
    reasons: tuple[str, ...] = ()
    interrupted: bool = False
    sensors: tuple[str, ...] = ("lidar", "imu")
    scans: int = 0
    statuses: Mapping[str, int] = field(default_factory=dict)
    distance: float = 0.0
    duration: float = 0.0
    start_end_gap: float = 0.0
    weakest_eigenvalue: float = float("nan")
    weakest_direction: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    weakest_index: int = -1
    blind_spans: tuple[BlindSpan, ...] = ()
    wall_seconds: float = 0.0
    seconds: Mapping[str, float] = field(default_factory=dict)
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    T_map_odom: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    final_poses: FinalPoses | None = None
    graph: GraphAccount | None = None
    level: Level = field(default_factory=Level)
    start: StartAccount | None = None
    failure: str = ""
    findings: tuple[Finding, ...] = ()
    repairs: tuple[SensorRepair, ...] = ()
    rig: Rig | None = None
    resumed: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def final(self) -> FinalPoses:
        """Where the run has been after all: `final_poses`, or all of it moved by ``T_map_odom``."""
        return FinalPoses.moved_by(self.T_map_odom) if self.final_poses is None else self.final_poses

    @property
    def ms_per_scan(self) -> float:
        """Wall time a scan, reading and writing included [ms]."""
        return 1e3 * self.wall_seconds / max(self.scans, 1)


def judge(
    statuses: Mapping[str, int],
    *,
    sensors: Iterable[str],
    held: int = 0,
    against_imu: int = 0,
    unsteady: int = 0,
    interrupted: bool = False,
    blind: Iterable[BlindSpan] = (),
    budget: float = 0.0,
    doubts: Iterable[str] = (),
) -> tuple[str, tuple[str, ...]]:
    """Decide how far a result is to be trusted, and say why.

    Parameters
    ----------
    statuses : mapping
        Scan status -> how many.
    sensors : iterable of str
        Sensors that the estimate rests on.
    held : int
        Scans that no IMU sample reached to the end of.
    against_imu : int
        Scans whose match moved the pose otherwise than the IMU allows.
    unsteady : int
        Scans within which the motion was no steady one, without an IMU to tell it.
    interrupted : bool
        Whether the run ended early; a reason, not a verdict on the part that was done.
    blind : iterable of BlindSpan
        Stretches along which one direction was not seen.
    budget : float
        One-sigma of position that such a stretch may cost [m].
    doubts : iterable of str
        What else speaks against the result, a sentence each.

    Returns
    -------
    status : str
        ``"ok"``, ``"degraded"`` or ``"lost"``.
    reasons : tuple of str
        One line each.
    """
    total = max(sum(statuses.values()), 1)
    share = {name: statuses.get(name, 0) / total for name in ("degenerate", "predicted", "lost", "empty")}
    unmatched = share["lost"] + share["predicted"] + share["empty"]
    lost: list[Reason] = []
    degraded: list[Reason] = []
    if share["lost"] >= LOST_SHARE:
        lost.append(Reason("lost", f"{share['lost']:.0%} of the scans were lost"))
    if "lidar" in sensors:
        if unmatched >= UNTRACKED_SHARE:
            lost.append(Reason("lost", f"{unmatched:.0%} of the scans could not be matched to the map"))
        elif unmatched >= DEGRADED_SHARE:
            text = f"{unmatched:.0%} of the scans could not be matched; the motion model carried on through them"
            degraded.append(Reason("unmatched", text))
        degraded += _blindness(tuple(blind), budget, share["degenerate"])
    else:
        text = "dead reckoning on the IMU alone: the position error grows with the square of time"
        degraded.append(Reason("imu-alone", text))
    if held / total >= HELD_SHARE:
        text = f"the IMU did not cover the end of {held / total:.0%} of the scans: check its clock and its gaps"
        degraded.append(Reason("imu-held", text))
    degraded += [Reason("other", doubt) for doubt in doubts]
    if against_imu / total >= DEGRADED_SHARE:
        text = (
            f"the IMU contradicts the match of {against_imu / total:.0%} of the scans: `heliograph check` tells "
            f"whether it is the IMU, else places that look alike were taken for one another"
        )
        degraded.append(Reason("against-imu", text))
    if unsteady / total >= DEGRADED_SHARE:
        text = (
            f"velocity or rate changed within {unsteady / total:.0%} of the sweeps by more than matching forgives, and "
            f"no IMU tells how: poses at their ends are off by the sigmas in scans.csv, and the map is blurred"
        )
        degraded.append(Reason("unsteady", text))
    status = "lost" if lost else "degraded" if degraded else "ok"
    early = (Reason("interrupted", "interrupted: the result covers the part that was read"),) if interrupted else ()
    return status, (*lost, *degraded, *early)


def _blindness(blind: tuple[BlindSpan, ...], budget: float, share: float) -> list[Reason]:
    """Return what blind stretches cost beyond the budget; where an odometry tells no sigmas, how often it was blind."""
    costly = [span for span in blind if span.growth > budget]
    if costly:
        worst = max(costly, key=lambda span: span.growth)
        more = f", the worst of {len(costly)} such stretches" if len(costly) > 1 else ""
        return [Reason("blind", f"{worst}{more}")]
    if share >= DEGRADED_SHARE and not any(span.sigma_after > 0.0 for span in blind):
        return [Reason("blind", f"one direction was unobservable in {share:.0%} of the scans")]
    return []


def doubts_of(findings: Iterable[Finding], events: Iterable[Event]) -> tuple[str, ...]:
    """Return what speaks against a result by its checks and events: those that failed, and those that are errors.

    What blind stretches cost is told to `judge` by themselves.
    """
    wrong = [event.message for event in events if event.severity == "error"]
    failed = [
        f"{finding.title}: {finding.evidence} - {finding.remedy}"
        for finding in findings
        if finding.verdict == "fail" and finding.code != "degenerate-drift"
    ]
    return (*wrong, *failed)


def fold_events(events: Iterable[Event]) -> tuple[Event, ...]:
    """Fold repeats of one code into its first occurrence, with the sum of the counts, in order of appearance."""
    folded: dict[tuple[str, str], Event] = {}
    for event in events:
        key = (event.code, event.severity)
        first = folded.get(key)
        folded[key] = event if first is None else replace(first, count=first.count + event.count)
    return tuple(folded.values())


class Tally(Stateful):
    """Adds results up as they pass, in constant memory."""

    _STATE: ClassVar = {
        "scans": int,
        "statuses": {str: int},
        "held": int,
        "against_imu": int,
        "unsteady": int,
        "stage_totals": {str: float},
        "distance": float,
        "weakest": fixed(float, array(np.float64, 3), int),
        "blind": PART,
        "_events": {fixed(str, str): Event},
        "_span": fixed(int, int),
        "_start": array(np.float64, 3),
        "_last": array(np.float64, 3),
        "_reach": float,
        "_gravity": fixed(array(np.float64, 3), array(np.float64, 2, 2)),
    }

    def __init__(self) -> None:
        self.scans = 0
        self.statuses: dict[str, int] = {}
        self.held = 0
        self.against_imu = 0
        self.unsteady = 0
        self.stage_totals: dict[str, float] = {}
        self.distance = 0.0
        self.weakest = (float("nan"), np.zeros(3), -1)
        self.blind = BlindSpans()
        self._events: dict[tuple[str, str], Event] = {}
        self._first: ScanResult | None = None
        self._span = (0, 0)
        self._start = np.zeros(3)
        self._last = np.zeros(3)
        self._reach = 0.0
        self._gravity = (np.zeros(3), np.zeros((2, 2)))

    def add(self, result: ScanResult) -> None:
        """Count one result."""
        position = result.T_odom_imu[:3, 3].copy()
        if self.scans == 0:
            self._start, self._last, self._span = position, position, (result.end_ns, result.end_ns)
        self.distance += float(np.linalg.norm(position - self._last))
        self._last, self._span = position, (self._span[0], result.end_ns)
        self._reach = max(self._reach, float(np.hypot(*(position - self._start)[:2])))
        self._gravity = (result.g_odom, result.covariance[GRAVITY, GRAVITY].copy())
        self.scans += 1
        self.statuses[result.status] = self.statuses.get(result.status, 0) + 1
        for stage, ms in result.timings.items():
            self.stage_totals[stage] = self.stage_totals.get(stage, 0.0) + ms
        if result.matches > 0 and not self.weakest[0] <= result.eigenvalues_translation[0]:
            self.weakest = (float(result.eigenvalues_translation[0]), result.weak_direction.copy(), result.index)
        self.blind.add(result)
        self.held += any(event.code == "imu-held" for event in result.events)
        self.against_imu += any(event.code == "match-against-imu" for event in result.events)
        self.unsteady += any(event.code == "unsteady-sweep" for event in result.events)
        self.add_events(result.events)

    def gap(self, final: FinalPoses) -> float:
        """Return the distance between the first and the last position, where they have been after all [m]."""
        T = final.T_map_odom(np.array(self._span, dtype=np.int64))
        ends = np.stack([self._start, self._last])
        first, last = np.einsum("nij,nj->ni", T[:, :3, :3], ends) + T[:, :3, 3]
        return float(np.linalg.norm(last - first))

    def add_events(self, events: Iterable[Event]) -> None:
        """Fold in what a scan, the odometry or the recording had to say."""
        for event in fold_events((*self._events.values(), *events)):
            self._events[event.code, event.severity] = event

    def summary(self, **facts: object) -> RunSummary:
        """Return the account; ``facts`` are the fields that the results do not tell."""
        base = RunSummary(
            scans=self.scans,
            statuses=dict(self.statuses),
            distance=self.distance,
            duration=(self._span[1] - self._span[0]) * 1e-9,
            start_end_gap=float(np.linalg.norm(self._last - self._start)),
            level=Level.of_gravity(*self._gravity, self._reach),
            weakest_eigenvalue=self.weakest[0],
            weakest_direction=self.weakest[1],
            weakest_index=self.weakest[2],
            stage_ms={stage: total / max(self.scans, 1) for stage, total in self.stage_totals.items()},
            events=tuple(self._events.values()),
        )
        return replace(base, **facts)  # type: ignore[arg-type]
