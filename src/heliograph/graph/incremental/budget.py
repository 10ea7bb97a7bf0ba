"""How much an update of an incremental smoother may do: bounds of the caller, of the settings, and savings.

An update whose work is bounded leaves some of it to later ones. Each of these is granted a part of the limit for what
was left, and spends it when enough has been saved up, so that most updates, those of one pose, stay short.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from heliograph.graph.incremental.settings import ISAM2Settings

__all__ = ["Budget", "Policy", "Savings"]

UNBOUNDED = 1 << 40  # variables
GRANTS = 64  # updates in which a whole limit is granted for what was left
SPENDINGS = 4  # a limit is spent in this many parts: less is saved up until it is worth an elimination
MAX_REPEATED_WORK = 2e6  # multiplications of an elimination that is worth repeating within the same update
MAX_REPEATED_STEPS = 5000  # variables whose step it computed
_MAX_UPDATES = 1 << 62  # that a counter holds
FAR = 2.0  # thresholds: a step longer than this is worth a pass of its own, a shorter one waits for the next update


class Budget(NamedTuple):  # one is made in every update, and a tuple is made faster than a frozen dataclass
    """What one pass over the tree may do: steps (2) to (7) of an update.

    Parameters
    ----------
    threshold : float
        Variables are relinearised where an element of their step is longer [rad, m].
    relinearize : int
        Variables that are relinearised; zero: none is looked for.
    farthest_first : bool
        The candidates with the longest steps are taken; else those that were found first.
    eliminate : int
        Variables that are eliminated, in whole fronts and at least one.
    wildfire : float
        Steps that change by no more than this are not carried on [rad, m].
    fluid_threshold : float
        Variables whose step comes out longer become candidates for relinearisation [rad, m].
    steps : int
        Variables whose step is computed; beyond, steps are deferred.
    deferred_steps : int
        Variables of earlier deferred steps that are computed within `steps`.
    from_savings : bool
        The deferred steps are paid for by `Savings`.
    """

    threshold: float
    relinearize: int
    farthest_first: bool
    eliminate: int
    wildfire: float
    fluid_threshold: float
    steps: int
    deferred_steps: int
    from_savings: bool


class Savings:
    """What updates may spend on one kind of work that earlier ones left.

    Parameters
    ----------
    limit : int
        Variables in one update; also what can be saved up.
    """

    __slots__ = ("left", "limit")

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.left = limit

    def grant(self) -> None:
        """Add the part of one update."""
        if self.left < self.limit:
            self.left = min(self.limit, self.left + max(self.limit // GRANTS, 1))

    def due(self, wanted: int) -> int:
        """Return how many variables may be done now: all that was saved up, or none where that is too little."""
        return self.left if wanted and self.left >= min(wanted, self.limit // SPENDINGS) else 0

    def spend(self, count: int) -> None:
        """Take off what was done."""
        if count:
            self.left = max(self.left - count, 0)


class _Tree(Protocol):
    """What a policy asks of the tree."""

    @property
    def waiting(self) -> int: ...
    @property
    def fluid(self) -> int: ...
    @property
    def longest_fluid(self) -> float: ...
    @property
    def deferred(self) -> int: ...


class Policy:
    """Makes the budget of each pass; keeps what was saved up between updates.

    Parameters
    ----------
    settings : ISAM2Settings
        The limits.
    """

    __slots__ = ("_always_exact", "_usual", "relinearizations", "settings", "steps", "updates")

    def __init__(self, settings: ISAM2Settings) -> None:
        self.settings = settings
        self.updates = 0  # that were made
        self.relinearizations = Savings(settings.max_relinearized)
        self.steps = Savings(settings.max_steps)
        self._always_exact = settings.wildfire == 0.0 or settings.relinearize_threshold == 0.0
        self._usual = self._from_savings(0, 0)  # of most updates: nothing was left to be caught up with

    def budget(self, tree: _Tree, *, max_variables: int | None = None, exact: bool = False) -> Budget:
        """Return what a pass may do.

        Parameters
        ----------
        tree : native Bayes tree
            As the pass finds it.
        max_variables : int, optional
            Bound of the caller's.
        exact : bool
            Nothing is to be left, whatever the settings bound.
        """
        settings = self.settings
        exact = exact or self._always_exact
        if max_variables is None and not exact:
            if not (tree.fluid or tree.deferred):
                return self._usual
            deferred_steps = self.steps.due(UNBOUNDED if tree.deferred else 0)
            return self._from_savings(self._relinearized(tree, None), deferred_steps)
        bound = max_variables or UNBOUNDED
        return Budget(
            threshold=settings.relinearize_threshold,
            relinearize=self._relinearized(tree, bound),
            farthest_first=True,
            eliminate=bound,
            wildfire=settings.wildfire,
            fluid_threshold=settings.relinearize_threshold,
            steps=UNBOUNDED if exact else min(settings.max_steps, bound),
            deferred_steps=UNBOUNDED,
            from_savings=False,
        )

    def _from_savings(self, relinearize: int, deferred_steps: int) -> Budget:
        settings = self.settings
        return Budget(
            threshold=settings.relinearize_threshold,
            relinearize=relinearize,
            farthest_first=False,
            eliminate=UNBOUNDED,
            wildfire=settings.wildfire,
            fluid_threshold=settings.relinearize_threshold,
            steps=settings.max_steps,
            deferred_steps=deferred_steps,
            from_savings=True,
        )

    def _relinearized(self, tree: _Tree, bound: int | None) -> int:
        """Return how many variables a pass relinearises: `bound`, or without it what has been saved up."""
        settings = self.settings
        skipped = (self.updates + 1) % settings.relinearize_skip != 0
        if skipped or tree.waiting or settings.relinearize_threshold == np.inf:  # never in the middle of an elimination
            return 0
        if bound is not None:
            return bound
        if tree.deferred and tree.fluid < self.relinearizations.limit // GRANTS and self.updates % GRANTS:
            return 0  # catching up finds a few in every update: together they are worth an elimination
        return self.relinearizations.due(tree.fluid)

    def to_converge(self, threshold: float) -> Budget:
        """Return the budget of a pass that is repeated until no step is longer than the threshold [rad, m]."""
        return Budget(
            threshold=threshold,
            relinearize=UNBOUNDED,
            farthest_first=True,
            eliminate=UNBOUNDED,
            wildfire=0.0,
            fluid_threshold=self.settings.relinearize_threshold,
            steps=UNBOUNDED,
            deferred_steps=UNBOUNDED,
            from_savings=False,
        )

    def repeats(self, tree: _Tree, work: float, solved: int) -> bool:
        """Tell whether a pass of some work [multiplications] and steps [variables] is repeated within its update.

        A loop has moved variables far: where that was cheap, a second pass leaves nothing for the next update. What is
        little beyond the threshold is little worse than what is within it, and the next update takes it along for the
        price of its own elimination. With a threshold of zero something is always left, and an update is one step of
        Gauss-Newton.
        """
        settings = self.settings
        due = (self.updates + 1) % settings.relinearize_skip == 0 and 0.0 < settings.relinearize_threshold < np.inf
        light = work <= MAX_REPEATED_WORK and solved <= MAX_REPEATED_STEPS
        far = FAR * settings.relinearize_threshold
        return bool(due and light and tree.fluid and not tree.deferred and tree.longest_fluid > far)

    def spend(self, budget: Budget, relinearized: int, caught_up: int) -> None:
        """Take off what a pass did: variables relinearised, and variables whose step had been deferred."""
        self.relinearizations.spend(relinearized)
        if budget.from_savings:
            self.steps.spend(caught_up)

    def end_update(self) -> None:
        """Count an update, and grant its part."""
        self.updates += 1
        self.relinearizations.grant()
        self.steps.grant()

    @property
    def savings(self) -> list[int]:
        """Variables that may be relinearised, and deferred steps that may be computed."""
        return [self.relinearizations.left, self.steps.left]

    def restore(self, updates: int, savings: list[int]) -> None:
        """Go on after some updates, with their `savings`."""
        relinearizations, steps = savings
        limits = (_MAX_UPDATES, self.relinearizations.limit, self.steps.limit)
        told = (updates, relinearizations, steps)
        if not all(type(number) is int and 0 <= number <= limit for number, limit in zip(told, limits, strict=True)):
            raise ValueError(f"{updates!r} updates with savings of {savings!r}")
        self.updates = updates
        self.relinearizations.left, self.steps.left = relinearizations, steps
