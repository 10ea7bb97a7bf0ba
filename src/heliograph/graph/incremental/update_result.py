"""What an update of an incremental smoother did."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import freeze

__all__ = ["PassTally", "UpdateResult"]

Int32s = NDArray[np.int32]
_STEPS = ("relinearize", "detach", "reorder", "eliminate", "solve")  # of a pass


def _none() -> Int32s:
    return np.zeros(0, dtype=np.int32)


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateResult:
    """What one update did.

    Parameters
    ----------
    factors : (N,) int32
        Numbers of the factors that were added, in the order of the graph's; by them they can be removed.
    relinearized : int
        Variables that were given a new linearisation point.
    reeliminated : int
        Variables that were eliminated again.
    cliques : int
        Cliques that were taken down.
    linearized : int
        Factors that were evaluated.
    solved : int
        Variables whose step was computed.
    iterations : int
        Passes: one; two where a variable moved beyond twice the threshold and the first was cheap; more only where
        convergence was asked for.
    settled : bool
        Nothing is pending or deferred: no variable is farther than the threshold from where its factors were
        linearised. That bounds no cost: after a loop that bends a long trajectory it may be percents above the optimum.
    converged : bool
        Convergence was asked for (`iterate`), and no element of a step is longer than that: one more step of
        Gauss-Newton would change nothing beyond it. Without `iterate` nothing has looked, and it is False.
    pending : int
        What waits for a later update, where the work of this one was bounded: variables to be eliminated, else
        variables to be relinearised, else `deferred`.
    deferred : int
        Branches of the tree whose steps are deferred, see `ISAM2Settings.max_steps`.
    let_go, taken_back : (K,), (L,) int32
        Numbers of the doubtful factors that this update has let go, its own among them, and of such as were let go
        before and count again; see `OutlierRejection`.
    cost_before, cost_after : float or None
        Cost of all factors, where asked for: before, at the old estimate and the new variables' start.
    seconds : dict
        By step: ``add``, ``relinearize``, ``detach``, ``reorder``, ``eliminate``, ``solve``; ``outliers``: their tests.
    """

    factors: Int32s
    relinearized: int
    reeliminated: int
    cliques: int
    linearized: int
    solved: int
    iterations: int
    settled: bool
    converged: bool
    pending: int = 0
    deferred: int = 0
    let_go: Int32s = field(default_factory=_none)
    taken_back: Int32s = field(default_factory=_none)
    cost_before: float | None = None
    cost_after: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)


class PassTally:
    """What an update has done so far, pass by pass, and the seconds that its steps took."""

    __slots__ = (
        "_began",
        "_tests_began",
        "cliques",
        "iterations",
        "linearized",
        "reeliminated",
        "relinearized",
        "seconds",
        "solved",
        "work",
    )

    def __init__(self) -> None:
        self.iterations = self.relinearized = self.reeliminated = self.cliques = self.linearized = self.solved = 0
        self.work = 0.0  # multiplications of the last elimination
        self.seconds: dict[str, float] = {}
        self._began = self._tests_began = time.perf_counter()

    def brought(self) -> None:
        """Note that what the update brings has been handed over."""
        self.seconds["add"] = time.perf_counter() - self._began

    def add(self, relinearized: int, counts: _core.TreeCounts, seconds: Sequence[float]) -> None:
        """Add a pass; seconds are those of its steps."""
        mine = self.seconds
        for step, took in zip(_STEPS, seconds, strict=True):
            mine[step] = mine[step] + took if self.iterations else took
        self.iterations += 1
        self.relinearized += relinearized
        self.reeliminated += counts.variables
        self.cliques += counts.cliques
        self.linearized += counts.linearized
        self.solved += counts.solved
        self.work = counts.work

    def begin_tests(self) -> None:
        """Note that from here on doubtful factors are decided about."""
        self._tests_began = time.perf_counter() - sum(self.seconds.values())

    def end_tests(self) -> None:
        """Note the seconds that the decisions took, without those of the passes among them."""
        self.seconds["outliers"] = time.perf_counter() - sum(self.seconds.values()) - self._tests_began

    def result(
        self,
        *,
        factors: Int32s,
        let_go: Int32s,
        taken_back: Int32s,
        converged: bool,
        pending: int,
        deferred: int,
        cost_before: float | None,
        cost_after: float | None,
    ) -> UpdateResult:
        """Return the record of the update."""
        return UpdateResult(
            relinearized=self.relinearized,
            reeliminated=self.reeliminated,
            cliques=self.cliques,
            linearized=self.linearized,
            solved=self.solved,
            iterations=self.iterations,
            seconds=self.seconds,
            factors=factors,
            let_go=let_go,
            taken_back=taken_back,
            settled=not pending,
            converged=converged,
            pending=pending,
            deferred=deferred,
            cost_before=cost_before,
            cost_after=cost_after,
        )
