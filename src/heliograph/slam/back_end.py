"""The back-end: what each keyframe adds to one graph, on one page (DESIGN, section 9; docs/theory/slam.md)."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import Event, GraphAccount, Keyframe
from heliograph.graph import ISAM2, Between, Covariance, FactorGraph, Symbol, Values
from heliograph.lie import SE3, se3
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.gnss import GnssFactors, KeptFixes
from heliograph.slam.inertial_factors import InertialFactors
from heliograph.slam.loop_search import Candidate, LoopSearch
from heliograph.slam.loops import Ledger, LedgerEntry, LoopEvidence, diagonal, finished
from heliograph.slam.pose_factors import PoseFactors
from heliograph.slam.store import KeyframeStore
from heliograph.slam.wheels import WheelFactors

__all__ = ["BackEnd", "GraphUpdate"]

X = Symbol("X")
_CONVERGED = 1e-5  # an update that closes a loop goes on until no step is longer [rad], [m]
_BELIEVED = 0.9999  # a loop that the solution contradicts with this probability is taken back


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphUpdate:
    """What a keyframe changed.

    Parameters
    ----------
    T_map_odom : (4, 4) float64
        The back-end's only word to the front: where odom lies in the map at the last keyframe.
    loops : tuple of LedgerEntry
        Candidates that are new or were decided anew.
    candidates : mapping of int to tuple of int
        Queries that were begun, and the earlier keyframes that may show their places, the most promising first.
    moved : float
        How far the keyframe that moved most was moved [m].
    events : tuple of Event
        What a user should know.
    """

    T_map_odom: NDArray[np.float64]
    loops: tuple[LedgerEntry, ...]
    candidates: Mapping[int, tuple[int, ...]]
    moved: float
    events: tuple[Event, ...]

    def __post_init__(self) -> None:
        freeze(self)


class BackEnd:
    """One smoother over all keyframes; `add` is its page.

    Parameters
    ----------
    config : RunConfig
    store : KeyframeStore
        Takes the keyframes; an empty one.
    ledger : Ledger, optional
        That of an earlier session.
    fixes : GnssFactors, optional
        Satellite fixes, which hold the map where they are believed; by default none come.
    """

    def __init__(
        self,
        config: RunConfig,
        store: KeyframeStore,
        *,
        ledger: Ledger | None = None,
        fixes: GnssFactors | None = None,
    ) -> None:
        self._config, self.store = config, store
        self._smoother, self._steps = ISAM2(), FactorGraph()
        self.chain = OdometryChain()
        self.ledger = ledger if ledger is not None else Ledger(config.loops)
        self.fixes = fixes if fixes is not None else GnssFactors(config)
        self.wheels = WheelFactors(config)
        self._search = LoopSearch(store, self.chain, config.slam, config.places, config.loops)
        self._waiting: deque[int] = deque()  # keyframes at which loops are still to be looked for
        self._query: Generator[None, None, None] | None = None  # the one that is being looked at
        self._news = _News()
        self._factors: InertialFactors | PoseFactors | None = None
        self._before: Keyframe | None = None
        self._in_force: dict[int, int] = {}  # number in the ledger -> number of its factor in the smoother

    @classmethod
    def replayed(
        cls, config: RunConfig, store: KeyframeStore, ledger: Ledger, fixes: KeptFixes | None = None
    ) -> BackEnd:
        """Return the back-end of a full store, with the loops of its ledger that stand and the fixes it kept."""
        back_end = cls(config, store, ledger=ledger)
        for keyframe in store:
            back_end.chain.append(keyframe.stamp_ns, keyframe.T_odom_imu, keyframe.step_covariance)
            back_end._smoother.update(*back_end._step(keyframe))
        back_end._enforce()
        if fixes is not None:
            back_end.fixes.keep(back_end._smoother, fixes)
        return back_end

    def compare(self, query: int, match: int) -> LoopEvidence:
        """Register two keyframes from where the graph and the odometry have them."""
        return finished(self._search.verification(query, Candidate(match=match), self.T_map_imu))

    def add(self, keyframe: Keyframe) -> GraphUpdate:
        """Take the next keyframe into the graph.

        The search for loops is done in pieces, `SlamConfig.loop_pieces` a keyframe: a query that takes more goes on at
        the next keyframes, and those behind it wait.
        """
        self.store.append(keyframe)  # (1) it is on disk before anything leans on it
        self.chain.append(keyframe.stamp_ns, keyframe.T_odom_imu, keyframe.step_covariance)
        graph, values = self._step(keyframe)  # (2) where it starts, (3) what odometry and IMU say of the step
        self._smoother.update(graph, values)  # (4)
        if self._config.slam.loops and self._search.due(keyframe.index):
            self._waiting.append(keyframe.index)
        self._go_on(self._config.slam.loop_pieces)  # (5) to (8)
        if self.fixes.due():  # later sensors join as factors
            self._place_on_earth()
        return self._word(keyframe)  # (9)

    def finish(self) -> GraphUpdate | None:
        """Look at all that still waits, and judge the fixes by all of it; None where there is no keyframe."""
        while self._query is not None or self._waiting:
            self._go_on(1)
        self._place_on_earth()
        return self._word(self._before) if self._before is not None else None

    def _go_on(self, pieces: int) -> None:
        for _ in range(pieces):
            if self._query is None:
                if not self._waiting:
                    return
                self._query = self._closing(self._waiting.popleft())
            try:
                next(self._query)
            except StopIteration:
                self._query = None

    def _closing(self, query: int) -> Generator[None, None, None]:
        """Look for the loops of one keyframe, in pieces of some milliseconds."""
        T_map_imu = self.T_map_imu
        candidates = self._search.candidates(query, T_map_imu)  # (5) who looks like it
        self._news.candidates[query] = tuple(candidate.match for candidate in candidates)
        changed: tuple[LedgerEntry, ...] = ()
        for candidate in candidates:
            yield
            evidence = yield from self._search.verification(query, candidate, T_map_imu)  # (6) does it match
            changed = self.ledger.add(evidence, self.chain.relative)  # (7) is it to be believed
            self._news.loops += changed
            if changed[-1].decision.verdict != "rejected":
                break
        if changed:
            self._news.loops += self._enforce()  # (8) smooth with the accepted, take back what the solution contradicts

    def _place_on_earth(self) -> None:
        """Bring in what the fixes tell, all of them weighed anew."""
        loops = tuple(
            (loop.match, loop.query, loop.T_match_query, loop.covariance)
            for loop in (entry.evidence for entry in self.ledger.accepted())
        )
        inertial = isinstance(self._factors, InertialFactors)
        self.fixes.enforce(self._smoother, self.chain, loops, inertial=inertial)

    @property
    def T_map_imu(self) -> Array:
        """Poses of all keyframes in the map, (K, 4, 4)."""
        keys = X(np.arange(len(self.chain)))
        return np.ascontiguousarray(self._smoother.estimate(keys).matrix[:, :4, :4])

    def covariance(self, index: int) -> Array:
        """Return the covariance of a keyframe's pose, right perturbation (6, 6); the first defines the frame."""
        return np.asarray(self._smoother.covariance(X(index))[:6, :6])

    @property
    def moved(self) -> float:
        """How far the keyframe that lies furthest from odometry was moved, seen from the first one [m]."""
        if not self.moves:
            return 0.0
        T = self.T_map_imu
        return _furthest(T[0] @ se3.inverse(self.chain.pose(0)) @ self.chain.T_odom_imu, T)

    @property
    def moves(self) -> bool:
        """Whether anything but odometry holds the keyframes: a loop, fixes, or wheels."""
        return self.closed or self.fixes.in_use or self.wheels.in_use

    @property
    def closed(self) -> bool:
        """Whether a loop stands."""
        return bool(self._in_force)

    def graph(self) -> tuple[FactorGraph, Values]:
        """Return all that the smoother holds: steps, inertial factors and the loops that stand, at its estimate."""
        whole = self._steps.copy()
        for entry in self.ledger.accepted():
            whole.add(_loop_factor(entry))
        for group in self.fixes.factors().groups():
            whole.adopt(group)
        return whole, self._smoother.estimate()

    def account(self, files: tuple[str, ...] = ()) -> GraphAccount:
        """Return the counts of the run."""
        verdicts = [entry.decision.verdict for entry in self.ledger]
        return GraphAccount(
            keyframes=len(self.chain),
            candidates=len(verdicts),
            accepted=verdicts.count("accepted"),
            rejected=verdicts.count("rejected"),
            held=verdicts.count("held"),
            revoked=verdicts.count("revoked"),
            moved=self.moved,
            gnss=self.fixes.account(self._smoother, self.T_map_imu) if len(self.chain) else None,
            wheels=self.wheels.account(self._smoother),
            files=files,
        )

    def _step(self, keyframe: Keyframe) -> tuple[FactorGraph, Values]:
        if self._before is None or self._factors is None:
            inertial = len(keyframe.imu) > 0 and bool(np.linalg.norm(keyframe.g_odom) > 0.0)
            self._factors = InertialFactors(self._config.slam, self._config.imu) if inertial else PoseFactors()
            graph, values = self._factors.first(keyframe)
        else:
            T_map_before = self._smoother.estimate(X(self._before.index)).matrix[:4, :4]
            graph, values = self._factors.step(self._before, keyframe, T_map_before)
            rolled, scale = self.wheels.step(self._before, keyframe, self._smoother)
            for added in rolled.groups():
                graph.adopt(added)
            for key in scale.keys().tolist():
                values.insert(key, scale.at(key))
        for added in graph.groups():
            self._steps.adopt(added)
        self._steps.fix(graph.fixed)
        self._before = keyframe
        return graph, values

    def _enforce(self) -> list[LedgerEntry]:
        """Bring the graph to what the ledger says now, and return what the solution makes of it."""
        standing = {entry.number: entry for entry in self.ledger.accepted()}
        news = [entry for number, entry in standing.items() if number not in self._in_force]
        gone = [self._in_force.pop(number) for number in list(self._in_force) if number not in standing]
        if not news and not gone:
            return []
        before = self.T_map_imu
        graph = FactorGraph()
        for entry in news:
            graph.add(_loop_factor(entry))
        result = self._smoother.update(graph, remove=gone, iterate=_CONVERGED)
        self._in_force |= {entry.number: int(k) for entry, k in zip(news, result.factors, strict=True)}
        revoked = self._contradicted()
        self._search.closed([self.ledger[number].evidence for number in self._in_force])
        self._news.moved = max(self._news.moved, _furthest(before, self.T_map_imu))
        return revoked

    def _contradicted(self) -> list[LedgerEntry]:
        """Take back the loops that the solution does not bear out, the worst first, until all that stand agree."""
        revoked: list[LedgerEntry] = []
        gate = chi_square_quantile(_BELIEVED, 6)
        slack = diagonal(self._config.loops.slack_deg, self._config.loops.slack)
        while self._in_force:
            T = self.T_map_imu
            off = {number: _misfit(self.ledger[number], T, slack) for number in self._in_force}
            worst = max(off, key=lambda number: off[number])
            if off[worst] <= gate:
                break
            revoked.append(self.ledger.revoke(worst, "solve", chi2=off[worst], allowed=gate))
            self._smoother.update(remove=[self._in_force.pop(worst)], iterate=_CONVERGED)
        return revoked

    def _word(self, keyframe: Keyframe) -> GraphUpdate:
        news, self._news = self._news, _News()
        T_map_imu = self._smoother.estimate(X(keyframe.index)).matrix[:4, :4]
        return GraphUpdate(
            T_map_odom=T_map_imu @ se3.inverse(keyframe.T_odom_imu),
            loops=tuple(news.loops),
            candidates=news.candidates,
            moved=news.moved,
            events=_events(keyframe, news.loops, news.moved),
        )


@dataclass(slots=True)
class _News:
    """What has come of the search since the last keyframe."""

    loops: list[LedgerEntry] = field(default_factory=list)
    candidates: dict[int, tuple[int, ...]] = field(default_factory=dict)
    moved: float = 0.0


def _furthest(before: Array, after: Array) -> float:
    return float(np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1).max(initial=0.0))


def _loop_factor(entry: LedgerEntry) -> Between:
    loop = entry.evidence
    return Between(X(loop.match), X(loop.query), SE3(loop.T_match_query), Covariance(loop.covariance))


def _misfit(entry: LedgerEntry, T_map_imu: Array, slack: Array) -> float:
    """Squared distance between a loop and the solution, in the loop's own covariance and the slack."""
    loop = entry.evidence
    d = se3.local(loop.T_match_query, se3.inverse(T_map_imu[loop.match]) @ T_map_imu[loop.query])
    return float(d @ np.linalg.solve(loop.covariance + slack, d))


def _events(keyframe: Keyframe, changed: Sequence[LedgerEntry], moved: float) -> tuple[Event, ...]:
    accepted = [entry for entry in changed if entry.decision.verdict == "accepted"]
    revoked = [entry for entry in changed if entry.decision.verdict == "revoked"]
    events = []
    if accepted:
        pairs = ", ".join(f"{e.evidence.query} to {e.evidence.match}" for e in accepted[:3])
        message = f"a loop was closed (keyframes {pairs}); the map moved by up to {moved:.3f} m"
        events.append(Event(code="loop", severity="info", message=message, stamp_ns=keyframe.stamp_ns))
    if revoked:
        message = f"{len(revoked)} loops were taken back: {revoked[0].decision.text}"
        events.append(Event(code="loop-revoked", message=message, stamp_ns=keyframe.stamp_ns))
    return tuple(events)
