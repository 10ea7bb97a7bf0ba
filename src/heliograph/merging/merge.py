"""Several runs in one graph, and a run's folder of it: what is linked is one map, what is not stays apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.data import ImuBatch, Keyframe
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.merging.links import Link, PlaceCounter, find_links
from heliograph.merging.sessions import RunSession
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.loops import Ledger, LedgerEntry

__all__ = ["MergedRuns", "MergedSession", "merge_runs"]

UNKNOWN = np.diag(np.repeat([3.0, 100.0], 3) ** 2)
"""Covariance of the step from one session to the next: nothing is known of it [rad^2, m^2]."""

_BETWEEN_NS = 10**9  # least time between two sessions in the merged store


@dataclass(frozen=True, slots=True, kw_only=True)
class MergedSession:
    """What became of one run.

    Parameters
    ----------
    name : str
    keyframes : int
    first : int or None
        Number of its first keyframe in the merged store; None where it is apart.
    shift_ns : int
        What its stamps were moved by, so that sessions follow each other [ns].
    links : int
        Links that hold it to the others.
    """

    name: str
    keyframes: int
    first: int | None
    shift_ns: int
    links: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MergedRuns:
    """Runs in one graph.

    Parameters
    ----------
    back_end : BackEnd
        Keyframes, ledger and solution.
    sessions : tuple of MergedSession
        As they were given.
    revoked : int
        Links and loops that the common solution contradicts.
    """

    back_end: BackEnd
    sessions: tuple[MergedSession, ...]
    revoked: int

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def apart(self) -> tuple[str, ...]:
        """Names of the runs that nothing links for sure."""
        return tuple(session.name for session in self.sessions if session.first is None)


def merge_runs(sessions: Sequence[RunSession], folder: Path, watch: PlaceCounter | None = None) -> MergedRuns:
    """Link runs, put the linked ones' keyframes into one store, and solve one graph.

    The frame is the first run's. A run's own loops come along as they stand. Satellite fixes and wheels do not.

    Parameters
    ----------
    sessions : sequence of RunSession
        Two at least.
    folder : Path
        Where the merged store goes.

    Raises
    ------
    DataError
        Fewer than two runs, or none that is linked to the first one for sure.
    OutputError
        The store cannot be written.
    """
    if len(sessions) < 2:
        raise DataError("one run is nothing to merge; name two at least")
    links = {(a, b): find_links(sessions[a], sessions[b], watch) for a, b in combinations(range(len(sessions)), 2)}
    sure = {pair: [link for link in some if link.decision.verdict == "accepted"] for pair, some in links.items()}
    poses = _frames(sessions, sure)
    if len(poses) < 2:
        names = ", ".join(session.name for session in sessions[1:])
        raise DataError(
            f"nothing links {names} to {sessions[0].name} for sure: they do not overlap, or only where places look "
            f"alike ({sum(len(some) for some in links.values())} places were looked at closely); nothing was merged"
        )
    store = KeyframeStore.create(folder)
    first, shifts = _fill(store, sessions, poses)
    store.close()
    config = sessions[0].run.config
    ledger = Ledger(config.loops, _entries(sessions, first, links))
    standing = len(ledger.accepted())
    back_end = BackEnd.replayed(config, store, ledger)
    told = tuple(
        MergedSession(
            name=session.name, keyframes=len(session), first=first.get(k), shift_ns=shifts.get(k, 0),
            links=sum(len(some) for pair, some in sure.items() if k in pair),
        )
        for k, session in enumerate(sessions)
    )  # fmt: skip
    return MergedRuns(back_end=back_end, sessions=told, revoked=standing - len(ledger.accepted()))


def _frames(sessions: Sequence[RunSession], sure: Mapping[tuple[int, int], Sequence[Link]]) -> dict[int, Array]:
    """Return ``T_map0_mapk`` of the runs that sure links reach from the first one, over the most links first."""
    poses = {0: np.eye(4)}
    while True:
        open_pairs = [(len(some), pair) for pair, some in sure.items() if some and len(set(pair) & set(poses)) == 1]
        if not open_pairs:
            return poses
        a, b = max(open_pairs)[1]
        T_a_b = _between(sessions[a], sessions[b], sure[a, b])
        if a in poses:
            poses[b] = poses[a] @ T_a_b
        else:
            poses[a] = poses[b] @ se3.inverse(T_a_b)


def _between(there: RunSession, here: RunSession, links: Sequence[Link]) -> Array:
    """Return ``T_there_here`` of two maps by the link that lies in the middle of all."""
    T = np.stack([
        there.T_map_imu[e.match] @ e.T_match_query @ se3.inverse(here.T_map_imu[e.query])
        for e in (link.evidence for link in links)
    ])  # fmt: skip
    at = np.median(T[:, :3, 3], axis=0)
    return np.asarray(T[int(np.argmin(np.linalg.norm(T[:, :3, 3] - at, axis=1)))])


def _fill(
    store: KeyframeStore, sessions: Sequence[RunSession], poses: Mapping[int, Array]
) -> tuple[dict[int, int], dict[int, int]]:
    """Append the keyframes of all linked sessions, and return where each begins and what its stamps were moved by."""
    first: dict[int, int] = {}
    shifts: dict[int, int] = {}
    for k in sorted(poses):
        session = sessions[k]
        # Odometry's own poses, whose steps the graph is made of, laid where the run's map lies at its first keyframe.
        T = poses[k] @ session.T_map_imu[0] @ se3.inverse(session.run.store.T_odom_imu(0))
        last_ns = int(store.stamps_ns[-1]) if len(store) else -(1 << 62)
        begin_ns = int(session.run.store.stamps_ns[0])
        shifts[k] = max(0, last_ns + _BETWEEN_NS - begin_ns)
        first[k] = len(store)
        for keyframe in session.run.store:
            begins = keyframe.index == 0 and len(store) > 0
            store.append(_moved(keyframe, len(store), T, shifts[k], begins=begins))
    return first, shifts


def _moved(keyframe: Keyframe, index: int, T: Array, shift_ns: int, *, begins: bool) -> Keyframe:
    imu = keyframe.imu
    if begins:
        imu = ImuBatch.joined([])
    elif shift_ns:
        imu = replace(imu, stamps_ns=imu.stamps_ns + shift_ns, received_ns=imu.received_ns + shift_ns)
    return replace(
        keyframe,
        index=index,
        stamp_ns=keyframe.stamp_ns + shift_ns,
        T_odom_imu=np.ascontiguousarray(T @ keyframe.T_odom_imu),
        v_odom=T[:3, :3] @ keyframe.v_odom,
        g_odom=T[:3, :3] @ keyframe.g_odom,
        step_covariance=UNKNOWN if begins else keyframe.step_covariance,
        imu=imu,
    )


def _entries(
    sessions: Sequence[RunSession], first: Mapping[int, int], links: Mapping[tuple[int, int], Sequence[Link]]
) -> list[LedgerEntry]:
    """Return the ledger: each run's own entries, then all that was found between them, numbered anew."""
    entries: list[LedgerEntry] = []
    for k in sorted(first):
        for entry in sessions[k].run.ledger:
            e = replace(entry.evidence, query=entry.evidence.query + first[k], match=entry.evidence.match + first[k])
            entries.append(LedgerEntry(number=len(entries), evidence=e, decision=entry.decision))
    for (a, b), some in links.items():
        if a not in first or b not in first:
            continue
        for link in some:
            e = replace(link.evidence, query=link.evidence.query + first[b], match=link.evidence.match + first[a])
            entries.append(LedgerEntry(number=len(entries), evidence=e, decision=link.decision))
    return entries


def session_facts(merged: MergedRuns) -> list[dict[str, Any]]:
    """Return the sessions as ``run.json`` has them."""
    return [
        {
            "name": session.name,
            "keyframes": session.keyframes,
            "linked": session.first is not None,
            "first_keyframe": session.first,
            "stamp_shift_ns": session.shift_ns,
            "links": session.links,
        }
        for session in merged.sessions
    ]
