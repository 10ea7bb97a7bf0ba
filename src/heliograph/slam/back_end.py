"""The back-end: what each keyframe adds to one graph, on one page (DESIGN, section 9; docs/theory/slam.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_quantile
from heliograph.config import RunConfig
from heliograph.data import Event, GraphAccount, Keyframe
from heliograph.graph import ISAM2, Between, Covariance, FactorGraph, Symbol, Values
from heliograph.lie import SE3, se3
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.inertial_factors import InertialFactors
from heliograph.slam.loop_search import Candidate, LoopSearch
from heliograph.slam.loops import Ledger, LedgerEntry, LoopEvidence
from heliograph.slam.pose_factors import PoseFactors
from heliograph.slam.store import KeyframeStore

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
    candidates : tuple of int
        Earlier keyframes that were taken for the same place, the most promising first, whether or not they were looked
        at.
    moved : float
        How far the keyframe that moved most was moved [m].
    events : tuple of Event
        What a user should know.
    """

    T_map_odom: NDArray[np.float64]
    loops: tuple[LedgerEntry, ...]
    candidates: tuple[int, ...]
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
    """

    def __init__(self, config: RunConfig, store: KeyframeStore, *, ledger: Ledger | None = None) -> None:
        self._config, self.store = config, store
        self._smoother, self._steps = ISAM2(), FactorGraph()
        self.chain = OdometryChain()
        self.ledger = ledger if ledger is not None else Ledger(config.loops)
        self._search = LoopSearch(store, self.chain, config.slam, config.places, config.loops)
        self._factors: InertialFactors | PoseFactors | None = None
        self._before: Keyframe | None = None
        self._in_force: dict[int, int] = {}  # number in the ledger -> number of its factor in the smoother

    @classmethod
    def replayed(cls, config: RunConfig, store: KeyframeStore, ledger: Ledger) -> BackEnd:
        """Return the back-end of a store that is full, with the loops of its ledger that stand; none are looked for."""
        back_end = cls(config, store, ledger=ledger)
        for keyframe in store:
            back_end.chain.append(keyframe.stamp_ns, keyframe.T_odom_imu, keyframe.step_covariance)
            back_end._smoother.update(*back_end._step(keyframe))
        back_end._enforce()
        return back_end

    def compare(self, query: int, match: int) -> LoopEvidence:
        """Register two keyframes from where the graph and the odometry have them."""
        return self._search.verified(query, Candidate(match=match), self.T_map_imu)

    def add(self, keyframe: Keyframe) -> GraphUpdate:
        """Take the next keyframe into the graph."""
        self.store.append(keyframe)  # (1) it is on disk before anything leans on it
        self.chain.append(keyframe.stamp_ns, keyframe.T_odom_imu, keyframe.step_covariance)
        graph, values = self._step(keyframe)  # (2) where it starts, (3) what odometry and IMU say of the step
        self._smoother.update(graph, values)  # (4)
        changed: list[LedgerEntry] = []
        candidates: tuple[Candidate, ...] = ()
        before: Array | None = None
        if self._config.slam.loops and self._search.due(keyframe.index):
            before = self.T_map_imu
            candidates = self._search.candidates(keyframe.index, before)  # (5) who looks like it
            for candidate in candidates:
                evidence = self._search.verified(keyframe.index, candidate, before)  # (6) does it match
                changed += self.ledger.add(evidence, self.chain.relative)  # (7) is it to be believed
                if changed[-1].decision.verdict != "rejected":
                    break
        if changed:
            changed += self._enforce()  # (8) smooth with the accepted, take back what the solution contradicts
        return self._word(keyframe, before, tuple(changed), tuple(c.match for c in candidates))  # (9)

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
        """How far loops have moved the keyframe that lies furthest from odometry, seen from the first one [m]."""
        if not self.closed:
            return 0.0
        T = self.T_map_imu
        return _furthest(T[0] @ se3.inverse(self.chain.pose(0)) @ self.chain.T_odom_imu, T)

    @property
    def closed(self) -> bool:
        """Whether a loop stands."""
        return bool(self._in_force)

    def graph(self) -> tuple[FactorGraph, Values]:
        """Return all that the smoother holds: steps, inertial factors and the loops that stand, at its estimate."""
        whole = self._steps.copy()
        for entry in self.ledger.accepted():
            whole.add(_loop_factor(entry))
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
        graph = FactorGraph()
        for entry in news:
            graph.add(_loop_factor(entry))
        result = self._smoother.update(graph, remove=gone, iterate=_CONVERGED)
        self._in_force |= {entry.number: int(k) for entry, k in zip(news, result.factors, strict=True)}
        revoked = self._contradicted()
        self._search.closed([self.ledger[number].evidence for number in self._in_force])
        return revoked

    def _contradicted(self) -> list[LedgerEntry]:
        """Take back the loops that the solution does not bear out, the worst first, until all that stand agree."""
        revoked: list[LedgerEntry] = []
        gate = chi_square_quantile(_BELIEVED, 6)
        while self._in_force:
            T = self.T_map_imu
            off = {number: _misfit(self.ledger[number], T) for number in self._in_force}
            worst = max(off, key=lambda number: off[number])
            if off[worst] <= gate:
                break
            revoked.append(self.ledger.revoke(worst, "solve", chi2=off[worst], allowed=gate))
            self._smoother.update(remove=[self._in_force.pop(worst)], iterate=_CONVERGED)
        return revoked

    def _word(
        self, keyframe: Keyframe, before: Array | None, changed: tuple[LedgerEntry, ...], candidates: tuple[int, ...]
    ) -> GraphUpdate:
        moved = _furthest(before, self.T_map_imu) if changed and before is not None else 0.0
        T_map_imu = self._smoother.estimate(X(keyframe.index)).matrix[:4, :4]
        return GraphUpdate(
            T_map_odom=T_map_imu @ se3.inverse(keyframe.T_odom_imu),
            loops=changed,
            candidates=candidates,
            moved=moved,
            events=_events(keyframe, changed, moved),
        )


def _furthest(before: Array, after: Array) -> float:
    return float(np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1).max(initial=0.0))


def _loop_factor(entry: LedgerEntry) -> Between:
    loop = entry.evidence
    return Between(X(loop.match), X(loop.query), SE3(loop.T_match_query), Covariance(loop.covariance))


def _misfit(entry: LedgerEntry, T_map_imu: Array) -> float:
    """Squared distance between a loop and the solution, in the loop's own covariance."""
    loop = entry.evidence
    d = se3.local(loop.T_match_query, se3.inverse(T_map_imu[loop.match]) @ T_map_imu[loop.query])
    return float(d @ np.linalg.solve(loop.covariance, d))


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
