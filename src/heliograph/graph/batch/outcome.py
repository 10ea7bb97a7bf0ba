"""What a minimiser reports of its own work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from heliograph.graph.problem.problem import Cost

__all__ = ["Iteration", "Minimum", "Observer", "Trace"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Iteration:
    """One step of a solver.

    Parameters
    ----------
    number : int
        From 1.
    cost : float
        After the step; as before it where the step was rejected.
    chi2 : float
        Likewise.
    accepted : bool
        The step was taken.
    gain_ratio : float
        Decrease of the true robust cost over that of the quadratic model; NaN where there was no step to try.
    damping : float
        That the step was computed with (Levenberg-Marquardt), or the trust radius (Dogleg).
    """

    number: int
    cost: float
    chi2: float
    accepted: bool
    gain_ratio: float
    damping: float


Observer: TypeAlias = Callable[[Iteration], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Minimum:
    """Where a minimiser ended.

    Parameters
    ----------
    status : str
        ``converged``, ``max_iterations``, ``stalled`` (no step lowers the cost although the model says so),
        ``diverged`` (Gauss-Newton's cost rose) or ``indefinite`` (the normal equations have no Cholesky factor).
    iterations : tuple of Iteration
        All of them.
    chi2, cost : float
        At the end.
    indefinite_key : int or None
        Variable at which the factorisation failed.
    """

    status: str
    iterations: tuple[Iteration, ...]
    chi2: float
    cost: float
    indefinite_key: int | None = None


class Trace:
    """The iterations of one search, as they happen."""

    __slots__ = ("_observe", "steps")

    def __init__(self, observe: Observer) -> None:
        self.steps: list[Iteration] = []
        self._observe = observe

    def record(self, cost: Cost, *, accepted: bool, gain_ratio: float, damping: float) -> None:
        """Note a step and tell the observer."""
        step = Iteration(
            number=len(self.steps) + 1,
            cost=cost.cost,
            chi2=cost.chi2,
            accepted=accepted,
            gain_ratio=gain_ratio,
            damping=damping,
        )
        self.steps.append(step)
        self._observe(step)

    def minimum(self, status: str, cost: Cost, indefinite_key: int | None = None) -> Minimum:
        """Return the search's report."""
        return Minimum(
            status=status,
            iterations=tuple(self.steps),
            chi2=cost.chi2,
            cost=cost.cost,
            indefinite_key=indefinite_key,
        )
