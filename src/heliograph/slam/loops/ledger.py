"""The ledger of loops: every candidate with its evidence and the decision about it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from heliograph.arrays import Mask
from heliograph.config import LoopConfig
from heliograph.errors import DataError
from heliograph.slam.loops.judge import agreements, judge, judge_together
from heliograph.slam.loops.records import REASONS, LoopDecision, LoopEvidence, RelativePose
from heliograph.snapshots import Stateful, fixed

__all__ = ["Ledger", "LedgerEntry"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerEntry:
    """A candidate.

    Parameters
    ----------
    number : int
        Its place in the ledger, from 0: its name on the command line.
    evidence : LoopEvidence
    decision : LoopDecision
    """

    number: int
    evidence: LoopEvidence
    decision: LoopDecision


class Ledger(Stateful):
    """Candidates and decisions. It changes only by its verbs, and each says which entries changed.

    Parameters
    ----------
    config : LoopConfig, optional
    entries : iterable of LedgerEntry
        Those of an earlier session, in their order.
    """

    _STATE: ClassVar = {
        "_entries": [LedgerEntry],
        "_agree": {fixed(int, int): bool},
    }

    def __init__(self, config: LoopConfig | None = None, entries: Iterable[LedgerEntry] = ()) -> None:
        self.config = config or LoopConfig()
        self._entries = list(entries)
        self._agree: dict[tuple[int, int], bool] = {}
        for place, entry in enumerate(self._entries):
            if entry.number != place:
                raise DataError(f"entry {place} of the ledger has number {entry.number}; entries must be in order")

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[LedgerEntry]:
        return iter(self._entries)

    def __getitem__(self, number: int) -> LedgerEntry:
        if not 0 <= number < len(self._entries):
            held = f"0 to {len(self._entries) - 1}" if self._entries else "none"
            raise DataError(f"there is no loop {number}; the ledger has {held}")
        return self._entries[number]

    def accepted(self) -> tuple[LedgerEntry, ...]:
        """Return the loops that are in force."""
        return tuple(e for e in self._entries if e.decision.verdict == "accepted")

    def add(self, evidence: LoopEvidence, relative: RelativePose) -> tuple[LedgerEntry, ...]:
        """Enter a candidate, judge it and those that it may help, and return the entries that are new or changed.

        Parameters
        ----------
        evidence : LoopEvidence
        relative : callable
            Keyframes a < b -> odometry's ``T_a_b`` and its covariance.
        """
        entry = self._enter(evidence, judge(evidence, self.config))
        if entry.decision.verdict != "held":
            return (entry,)
        changed = self.judge_again(relative)
        return changed if any(e.number == entry.number for e in changed) else (*changed, self._entries[entry.number])

    def add_by_hand(self, evidence: LoopEvidence) -> LedgerEntry:
        """Enter a loop that a person vouches for: it is accepted."""
        return self._enter(evidence, LoopDecision(verdict="accepted", reason="by-hand"))

    def revoke(self, number: int, reason: str = "revoked-by-hand", **numbers: float) -> LedgerEntry:
        """Take an accepted loop back; it is not accepted again but by hand.

        Raises
        ------
        DataError
            There is no such loop, or it is not in force.
        """
        entry = self[number]
        if reason not in REASONS:
            raise DataError(f"'{reason}' is no reason of the ledger; there are {', '.join(REASONS)}")
        if entry.decision.verdict != "accepted":
            raise DataError(f"loop {number} is {entry.decision.verdict}, not accepted: there is nothing to revoke")
        return self._decide(number, LoopDecision(verdict="revoked", reason=reason, numbers=numbers))

    def judge_again(self, relative: RelativePose) -> tuple[LedgerEntry, ...]:
        """Judge the latest held and accepted loops together, and return the entries that changed."""
        group = [e for e in self._entries if e.decision.verdict in ("held", "accepted")][-self.config.compared :]
        loops = [e.evidence for e in group]
        agree = self._agreement(group, relative)
        decisions = judge_together(loops, [e.decision for e in group], agree, relative, self.config)
        moved = [
            (e, d)
            for e, d in zip(group, decisions, strict=True)
            if (d.verdict, d.reason) != (e.decision.verdict, e.decision.reason)
        ]
        for entry, decision in zip(group, decisions, strict=True):
            if decision is not entry.decision:
                self._decide(entry.number, decision)
        return tuple(self._entries[e.number] for e, _ in moved)

    def _enter(self, evidence: LoopEvidence, decision: LoopDecision) -> LedgerEntry:
        self._entries.append(LedgerEntry(number=len(self._entries), evidence=evidence, decision=decision))
        return self._entries[-1]

    def _decide(self, number: int, decision: LoopDecision) -> LedgerEntry:
        old = self._entries[number]
        self._entries[number] = LedgerEntry(number=number, evidence=old.evidence, decision=decision)
        return self._entries[number]

    def _agreement(self, group: list[LedgerEntry], relative: RelativePose) -> Mask:
        """Compare pairs that were not compared yet: the covariance that odometry had then is kept."""
        n = len(group)
        agree = np.eye(n, dtype=bool)
        for i, entry in enumerate(group):
            unknown = [e for e in group[:i] if (e.number, entry.number) not in self._agree]
            if unknown:
                found = agreements(entry.evidence, [e.evidence for e in unknown], relative, self.config)
                for other, same in zip(unknown, found.tolist(), strict=True):
                    self._agree[other.number, entry.number] = same
            for j, other in enumerate(group[:i]):
                agree[i, j] = agree[j, i] = self._agree[other.number, entry.number]
        if len(self._agree) > n * n:  # a shift of many hours keeps no more than these, give or take
            inside = {entry.number for entry in group}
            self._agree = {pair: same for pair, same in self._agree.items() if inside.issuperset(pair)}
        return agree
