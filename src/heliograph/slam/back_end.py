"""The back-end: what each keyframe adds to one graph, on one page (DESIGN, section 9; docs/theory/slam.md)."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import Event, GraphAccount, Keyframe
from heliograph.errors import DataError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import ISAM2, Between, Covariance, FactorGraph, Symbol, Values
from heliograph.lie import SE3, se3
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.gnss import GnssFactors, KeptFixes
from heliograph.slam.inertial_factors import InertialFactors, scan_covariance
from heliograph.slam.levelling import Levelling
from heliograph.slam.loop_search import Candidate, LoopSearch
from heliograph.slam.loops import Ledger, LedgerEntry, LoopEvidence, diagonal, finished
from heliograph.slam.open_query import OpenQuery
from heliograph.slam.past_steps import PastSteps
from heliograph.slam.pose_factors import PoseFactors
from heliograph.slam.second_look import SecondLook
from heliograph.slam.step_log import StepLog, factors_for
from heliograph.slam.store import KeyframeStore
from heliograph.slam.wheels import WheelFactors
from heliograph.snapshots import PART, Snapshot, require

__all__ = ["BackEnd", "GraphUpdate"]

X, B = Symbol("X"), Symbol("B")
_PARTS = ("chain", "ledger", "fixes", "wheels", "_steps", "_search", "_second_look")
_STATE = {
    "smoother": {str: (str, {str: np.ndarray})},
    "parts": {str: PART},
    "waiting": [int],
    "query": PART,
    "loops": [LedgerEntry],
    "candidates": {int: [int]},
    "moved": float,
    "in_force": {int: int},
    "past": PART,
    "levels": PART,
    "numbers": {int: [int]},
    "bias_number": int,
}
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
        self._smoother = ISAM2()
        self.chain = OdometryChain()
        self.ledger = ledger if ledger is not None else Ledger(config.loops)
        self.fixes = fixes if fixes is not None else GnssFactors(config)
        self.wheels = WheelFactors(config)
        self._steps = StepLog(config, self.wheels)
        self._search = LoopSearch(store, self.chain, config.slam, config.places, config.loops)
        self._second_look = SecondLook()
        self._waiting: deque[int] = deque()  # keyframes at which loops are still to be looked for
        self._query: OpenQuery | None = None  # the one that is being looked at
        self._search_of_query: Iterator[None] = iter(())  # its search
        self._news = _News()
        self._factors: InertialFactors | PoseFactors | None = None
        self._past: PastSteps | None = None
        self._levels: Levelling | None = None
        self._numbers: dict[int, list[int]] = {}  # keyframe -> numbers in the smoother of the factors of the step to it
        self._bias_number = -1  # that of the prior of the oldest biases that are there
        self._said = 0  # factors of the latest step itself
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
            back_end._smooth(keyframe, *back_end._step(keyframe))
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
        self._smooth(keyframe, *self._step(keyframe))  # (2) where it starts, (3) what odometry and IMU say, (4)
        if self._config.slam.loops and self._search.due(keyframe.index):
            self._waiting.append(keyframe.index)
        self._go_on(self._config.slam.loop_pieces)  # (5) to (8)
        if self.fixes.due():  # later sensors join as factors
            self._place_on_earth()
        return self._word(keyframe)  # (9)

    def finish(self) -> GraphUpdate | None:
        """Look at all that still waits, and judge the fixes by all of it; None where there is no keyframe."""
        while self._query is not None or self._waiting or self._second_look:
            self._go_on(1)
        self._place_on_earth()
        return self._word(self._before) if self._before is not None else None

    def _go_on(self, pieces: int) -> None:
        for _ in range(pieces):
            if self._query is None:
                if not self._waiting and not self._second_look:
                    return
                # Second looks come last: nothing new waits for them.
                index = self._waiting.popleft() if self._waiting else self._second_look.take()
                self._query = self._opened(index)
                self._search_of_query = self._closing(self._query)
            try:
                next(self._search_of_query)
                self._query.pieces += 1
            except StopIteration:
                self._query = None

    def _opened(self, query: int) -> OpenQuery:
        T_map_imu = self.T_map_imu
        candidates = self._search.candidates(query, T_map_imu)  # (5) who looks like it
        self._news.candidates[query] = tuple(candidate.match for candidate in candidates)
        return OpenQuery(query, T_map_imu, candidates)

    def _closing(self, query: OpenQuery) -> Generator[None, None, None]:
        """Look for the loops of one keyframe, in pieces of some milliseconds."""
        while query.at < len(query.candidates):
            query.pieces, query.held = 0, self._search.held
            yield
            candidate = query.candidates[query.at]
            evidence = yield from self._search.verification(query.index, candidate, query.T_map_imu)  # (6) a match?
            changed = self.ledger.add(evidence, self.chain.relative)  # (7) is it to be believed
            self._news.loops += changed
            query.at += 1
            if changed[-1].decision.verdict != "rejected":
                break
        else:
            if query.candidates:
                self._second_look.refused(query.index)
        if query.at:
            before = set(self._in_force)
            self._news.loops += self._enforce()  # (8) smooth with the accepted, take back what the solution contradicts
            if set(self._in_force) - before:  # the way is known better now
                self._second_look.accepted()

    def snapshot(self) -> Snapshot:
        """Return all that the next keyframes depend on but for the keyframes themselves, which are in the store."""
        return {
            "smoother": self._smoother.snapshot(),
            "parts": {name: getattr(self, name).snapshot() for name in _PARTS},
            "waiting": self._waiting,
            "query": None if self._query is None else self._query.snapshot(),
            "loops": self._news.loops,
            "candidates": self._news.candidates,
            "moved": self._news.moved,
            "in_force": self._in_force,
            "past": None if self._past is None else self._past.snapshot(),
            "levels": None if self._levels is None else self._levels.snapshot(),
            "numbers": self._numbers,
            "bias_number": self._bias_number,
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another one that was made with the same arguments, and whose keyframes the store holds.

        Raises
        ------
        DataError
            It is none of such a back-end.
        """
        require(self, snapshot, _STATE)
        require(self, snapshot["parts"], dict.fromkeys(_PARTS, PART))
        self._smoother = ISAM2.restored(snapshot["smoother"], factors=SENSOR_FACTORS)
        for name in _PARTS:
            getattr(self, name).restore(snapshot["parts"][name])
        if len(self.chain) != len(self.store):
            raise DataError(f"the state of a back-end has {len(self.chain)} keyframes, the store {len(self.store)}")
        self._waiting, self._in_force = snapshot["waiting"], snapshot["in_force"]
        self._news = _News(snapshot["loops"], snapshot["candidates"], snapshot["moved"])
        if len(self.store):
            self._begin(self.store[0])
            self._before = self.store[len(self.store) - 1]
        for name, part in (("past", self._past), ("levels", self._levels)):
            if (part is None) != (snapshot[name] is None):
                raise DataError("the state of a back-end is one of other sensors")
            if part is not None:
                part.restore(snapshot[name])
        self._numbers, self._bias_number = snapshot["numbers"], snapshot["bias_number"]
        if snapshot["query"] is not None:
            self._query = OpenQuery.restored(snapshot["query"])
            self._go_on_with(self._query)

    def settle(self) -> None:
        """Have what lies beside the keyframes put on the disk itself."""
        self._search.settle()

    def release(self) -> None:
        """Let go of the files."""
        self._search.close()

    def _go_on_with(self, query: OpenQuery) -> None:
        """Bring the search of a query to where it was: a candidate is looked at from its beginning, as often as it was.

        With the local maps of then: those that are there take no piece.
        """
        held, pieces = self._search.held, query.pieces
        self._search.held = query.held
        self._search_of_query = self._closing(query)
        for _ in range(pieces):
            next(self._search_of_query, None)
        query.pieces = pieces
        if self._search.held != held:
            raise DataError("the state of a back-end has a search that does not lead to where it stood")

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
        """Return the covariance of a keyframe's pose, right perturbation (6, 6); the first defines the frame.

        Its own scan's noise is in it, and that of the scan by which the frame was laid: the graph's steps hold neither.
        """
        own = np.asarray(self._smoother.covariance(X(index))[:6, :6])
        if index == 0 or not isinstance(self._factors, InertialFactors):
            return own
        first = scan_covariance(self.store[1].lidar_information)  # the first scan is matched with nothing
        T = self.T_map_imu[[0, index]]
        carry = se3.adjoint(se3.inverse(T[1]) @ T[0])
        return np.asarray(own + scan_covariance(self.store[index].lidar_information) + carry @ first @ carry.T)

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
        whole = self._steps.graph(self.store, self._past)
        for entry in self.ledger.accepted():
            whole.add(_loop_factor(entry))
        if self._levels is not None:
            _extend(whole, self._levels.factors())
        _extend(whole, self.fixes.factors())
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
            factors = self._begin(keyframe)
            graph, values = factors.first(keyframe)
            self._said = len(graph)
        else:
            T_map_before = self._smoother.estimate(X(self._before.index)).matrix[:4, :4]
            graph, values = self._factors.step(self._before, keyframe, T_map_before)
            self._said = len(graph)
            self._steps.note(keyframe, T_map_before)
            _extend(graph, *self.wheels.step(self._before, keyframe, self._smoother), values)
            if self._past is None and self._levels is not None:  # poses without gravity: the windows tell it
                _extend(graph, *self._levels.add(self._before, keyframe), values)
        self._before = keyframe
        return graph, values

    def _begin(self, first: Keyframe) -> InertialFactors | PoseFactors:
        self._factors = factors_for(first, self._config)
        if isinstance(self._factors, InertialFactors):
            self._past = PastSteps(self._factors)
        if self._past is None or self._config.slam.window:  # else the preintegrated factors hold the level
            self._levels = Levelling(self._config.slam, self._config.imu, up_known=self._past is not None)
        return self._factors

    def _smooth(self, keyframe: Keyframe, graph: FactorGraph, values: Values) -> None:
        """Bring the step in; what has left the window of inertial smoothing becomes a step of poses."""
        steps, past, leaving = self._said, self._past, self._leaving(keyframe.index)
        if past is None or leaving is None:
            numbers = self._smoother.update(graph, values).factors
        else:
            before, after = self.store[leaving], self.store[leaving + 1]
            past.take(before, after)
            T_map_imu = np.ascontiguousarray(self._smoother.estimate(X(after.index)).matrix[:4, :4])
            if self._levels is not None:
                _extend(graph, *self._levels.add(before, after), values)
            for record in (past.step(leaving), *past.reach(T_map_imu)):
                graph.add(record)
            gone = [*self._numbers.pop(after.index), self._bias_number]
            numbers = self._smoother.update(graph, values, remove=gone, remove_variables=[int(B(leaving))]).factors
            self._bias_number = int(numbers[-1])
        if past is not None and keyframe.index == 0:
            self._bias_number = int(numbers[steps - 1])
        elif past is not None:
            self._numbers[keyframe.index] = numbers[:steps].tolist()

    def _leaving(self, newest: int) -> int | None:
        """Return the keyframe that leaves the window; None where none does."""
        window = self._config.slam.window
        return len(self._past) if self._past is not None and window and newest - len(self._past) > window else None

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
            numbers = list(self._in_force)
            off = _misfits([self.ledger[number].evidence for number in numbers], self.T_map_imu, slack)
            index = int(np.argmax(off))
            if off[index] <= gate:
                break
            worst = numbers[index]
            revoked.append(self.ledger.revoke(worst, "solve", chi2=float(off[index]), allowed=gate))
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


def _extend(graph: FactorGraph, more: FactorGraph, new: Values | None = None, values: Values | None = None) -> None:
    """Bring factors into a graph, and the variables that begin with them into its values."""
    for group in more.groups():
        graph.adopt(group)
    if new is not None and values is not None:
        for key in new.keys().tolist():
            values.insert(key, new.at(key))


def _furthest(before: Array, after: Array) -> float:
    return float(np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1).max(initial=0.0))


def _loop_factor(entry: LedgerEntry) -> Between:
    loop = entry.evidence
    return Between(X(loop.match), X(loop.query), SE3(loop.T_match_query), Covariance(loop.covariance))


def _misfits(loops: Sequence[LoopEvidence], T_map_imu: Array, slack: Array) -> Array:
    """Squared distances (N,) between loops and the solution, in each loop's own covariance and the slack."""
    T = se3.inverse(T_map_imu[[loop.match for loop in loops]]) @ T_map_imu[[loop.query for loop in loops]]
    d = se3.local(np.stack([loop.T_match_query for loop in loops]), T)
    weighted = np.linalg.solve(np.stack([loop.covariance for loop in loops]) + slack, d[..., None])[..., 0]
    return np.asarray((d * weighted).sum(axis=1))


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
