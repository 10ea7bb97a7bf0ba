"""Incremental smoothing: iSAM2 on a Bayes tree."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.config_checks import check_range
from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph.incremental.cliques import CliqueRecord, clique_records
from heliograph.graph.incremental.tree_archive import read_state, state_arrays, state_from, write_state
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Value
from heliograph.graph.model.values import Values

__all__ = ["ISAM2", "ISAM2Settings", "UpdateResult"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
_UNBOUNDED = 1 << 40
# What is worth repeating within the same update: multiplications of its elimination, variables whose step it computed.
_LIGHT, _FEW = 2e6, 5000
# Of what may be relinearised or solved in one update, one part of so many is granted with each for what was put off; it
# is spent when one part of so many has been saved up, so that most updates, those of one pose, stay short.
_GRANTED, _WORTH = 64, 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ISAM2Settings:
    """When an update linearises anew, and how far steps are carried down the tree.

    Parameters
    ----------
    relinearize_threshold : float
        A variable is linearised anew where an element of its step is longer [rad, m].
    relinearize_skip : int
        Only in every so-manieth update.
    wildfire : float
        Steps that change by no more than this are not carried on to what lies below [rad, m].
    most_steps : int
        Steps of so many variables are computed in one update; beyond, whole branches of the tree are put off to later
        updates, or until they are read: what is read is never old. A loop over a drive of a million poses moves all of
        them, and is no reason to wait. All are computed where a threshold is zero, where convergence is asked for, and
        in an update without factors.
    most_relinearized : int
        So many variables are linearised anew in one update; the others wait. Later updates take up a 64th of this and
        of ``most_steps`` each, gathered to quarters. Exceptions as for ``most_steps``.

    Raises
    ------
    ConfigError
        A value is out of its range.
    """

    relinearize_threshold: float = 0.1
    relinearize_skip: int = 1
    wildfire: float = 1e-3
    most_steps: int = 10_000
    most_relinearized: int = 10_000

    def __post_init__(self) -> None:
        check_range(self, "relinearize_threshold", "wildfire", low=0.0)
        check_range(self, "relinearize_skip", "most_steps", "most_relinearized", low=1)


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
        Variables that were eliminated anew.
    cliques : int
        Cliques that were taken down.
    linearized : int
        Factors that were evaluated.
    solved : int
        Variables whose step was computed.
    iterations : int
        Passes: one; two where variables moved beyond the threshold and the first was cheap; more only where convergence
        was asked for.
    converged : bool
        Nothing is pending or deferred, and no step is longer than the threshold that was asked for.
    pending : int
        What waits for a later update, where its work was bounded: variables to be eliminated, else variables to be
        linearised anew, else `deferred`.
    deferred : int
        Branches of the tree whose steps were put off, see `ISAM2Settings.most_steps`.
    cost_before, cost_after : float or None
        Of all factors, where asked for: before, at the old estimate and the new variables' start.
    seconds : dict
        By step: ``add``, ``relinearize``, ``detach``, ``reorder``, ``eliminate``, ``solve``.
    """

    factors: Ints
    relinearized: int
    reeliminated: int
    cliques: int
    linearized: int
    solved: int
    iterations: int
    converged: bool
    pending: int = 0
    deferred: int = 0
    cost_before: float | None = None
    cost_after: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)


class ISAM2:
    """A graph that grows, solved as it grows (Kaess et al., IJRR 2012).

    Parameters
    ----------
    settings : ISAM2Settings, optional
        Thresholds.

    Examples
    --------
    >>> smoother = ISAM2()
    >>> smoother.update(graph_of_the_first_pose, values_of_the_first_pose)
    >>> result = smoother.update(new_factors, new_values)
    >>> smoother.estimate(7)

    Notes
    -----
    The result does not depend on chance or time: the same updates give the same bits.
    """

    def __init__(self, settings: ISAM2Settings | None = None) -> None:
        self.settings = settings or ISAM2Settings()
        self._state = TreeState()
        self._updates = 0
        self._savings = _Savings(self.settings)

    def update(
        self,
        graph: FactorGraph | None = None,
        values: Values | None = None,
        *,
        remove: ArrayLike = (),
        iterate: float | None = None,
        most_iterations: int = 50,
        costs: bool = False,
        most_variables: int | None = None,
    ) -> UpdateResult:
        """Add factors and variables, remove factors, and bring the estimate up to date.

        Parameters
        ----------
        graph : FactorGraph, optional
            New factors, between old and new variables.
        values : Values, optional
            Where the new variables start.
        remove : (M,) int
            Numbers of factors to take out.
        iterate : float, optional
            Go on until no element of a step is longer than this [rad, m].
        most_iterations : int
            Limit of that.
        costs : bool
            Evaluate all factors before and after; this takes time that grows with the whole graph.
        most_variables : int, optional
            Linearise at most so many variables anew, the farthest first, and eliminate at most so many (a single clique
            is not divided). What is left is ``pending``: the next updates go on with it, whatever they add. Meanwhile
            old variables keep their estimate and new ones the value they came with; steps are computed when the last
            part is done. An update without the bound does all that is pending. Not bounded: an update that removes or
            switches factors, and the ordering.

        Raises
        ------
        GraphError
            The new factors do not fit the variables; nothing has changed.
        UnderconstrainedError
            The graph would no longer determine every variable; the message names what is free. Nothing has changed, and
            the smoother can be used further.
        """
        if most_variables is not None and (most_variables < 1 or iterate is not None):
            raise GraphError(f"most_variables={most_variables}: at least 1, and not together with iterate")
        tree, clock, most = self._state.native, _Clock(), most_variables or _UNBOUNDED
        added = self._state.add(graph, values)  # 1. new factors and variables ...
        self._state.remove(remove)  # ... and what leaves
        before = self._state.cost() if costs else None
        clock.lap("add")
        due = (self._updates + 1) % self.settings.relinearize_skip == 0
        threshold = self.settings.relinearize_threshold if due else np.inf
        empty = graph is None and values is None
        whole = iterate is not None or (empty and most == _UNBOUNDED)
        work = self._pass(threshold, self.settings.wildfire, graph, values, clock, most, whole)
        passes, converged = 1, not (tree.pending or tree.waiting or tree.deferred)
        if iterate is None and due and threshold > 0.0 and most == _UNBOUNDED and tree.pending and self._light():
            # A loop has moved variables far: where that is cheap, a second pass leaves nothing for the next update.
            # With a threshold of zero something is always pending, and an update is one step of Gauss-Newton.
            work = _sum(work, self._pass(threshold, self.settings.wildfire, None, None, clock, most))
            passes, converged = 2, not (tree.pending or tree.deferred)
        while iterate is not None and not (converged := tree.largest_step() <= iterate):
            if passes >= most_iterations:
                break
            tree.find_fluid(iterate)
            work = _sum(work, self._pass(iterate, 0.0, None, None, clock, most, True))
            passes += 1
        self._updates += 1
        self._savings.grant()
        return UpdateResult(
            factors=added,
            relinearized=work[0],
            reeliminated=work[1],
            cliques=work[2],
            linearized=work[4],
            solved=work[5],
            iterations=passes,
            converged=converged,
            pending=self._state.pending(),
            deferred=tree.deferred,
            cost_before=before,
            cost_after=self._state.cost() if costs else None,
            seconds=clock.seconds,
        )

    def _pass(
        self,
        threshold: float,
        wildfire: float,
        graph: FactorGraph | None,
        values: Values | None,
        clock: _Clock,
        most: int,
        whole: bool = False,
    ) -> list[int]:
        """Do steps 2 to 7 once; return the counts of what was done."""
        tree = self._state.native
        due = threshold < np.inf and not tree.waiting  # never in the middle of an elimination
        marked = self._relinearize(threshold, most, whole) if due else 0  # 2. fluid relinearisation
        clock.lap("relinearize")
        tree.detach()  # 3. the top of the tree is taken down
        self._state.evaluate_custom()
        clock.lap("detach")
        tree.reorder()  # 4. constrained ordering: the newest last
        clock.lap("reorder")
        failed = tree.eliminate(most)  # 5. elimination, and 6. orphans attached
        clock.lap("eliminate")
        if failed >= 0:
            raise UnderconstrainedError(self._state.refused(failed, graph, values))
        self._state.settle()
        self._savings.spend(0, marked)
        if not tree.waiting:
            self._carry_down(wildfire, most, whole)  # 7. wildfire
        clock.lap("solve")
        return [marked, *tree.counts()]

    def _relinearize(self, threshold: float, most: int, whole: bool) -> int:
        """Linearise anew what has moved: all, so many as the caller allows, or what has been saved up for it."""
        tree = self._state.native
        if whole or threshold == 0.0 or self.settings.wildfire == 0.0 or most != _UNBOUNDED:
            return tree.relinearize(threshold, most)
        if tree.deferred and tree.fluid < self.settings.most_relinearized // _GRANTED and self._updates % _GRANTED:
            return 0  # catching up finds a few in every update: together they are worth an elimination
        due = self._savings.due(0, tree.fluid)
        return tree.relinearize(threshold, due, farthest_first=False) if due else 0

    def _carry_down(self, wildfire: float, most: int, whole: bool) -> None:
        """Compute steps: so many as the settings and the caller allow, or all where an exact step is asked for."""
        settings, tree = self.settings, self._state.native
        if whole or wildfire == 0.0 or settings.relinearize_threshold == 0.0:
            tree.solve(wildfire, settings.relinearize_threshold, _UNBOUNDED, _UNBOUNDED)
        elif most != _UNBOUNDED:
            tree.solve(wildfire, settings.relinearize_threshold, min(settings.most_steps, most), _UNBOUNDED)
        else:
            later = self._savings.due(1, _UNBOUNDED if tree.deferred else 0)
            self._savings.spend(1, tree.solve(wildfire, settings.relinearize_threshold, settings.most_steps, later))

    def _light(self) -> bool:
        """Return whether the last pass was so cheap that another one within the same update is worth it."""
        tree = self._state.native
        return tree.work <= _LIGHT and tree.counts()[4] <= _FEW and not tree.deferred

    def finish(self) -> None:
        """Do all that bounded updates left to be eliminated, and compute the steps that were put off."""
        if self._state.native.waiting:
            self._pass(np.inf, self.settings.wildfire, None, None, _Clock(), _UNBOUNDED)
        self._state.native.finish_steps()

    def marginalize(self, keys: ArrayLike) -> None:
        """Take variables out for good; what their factors said stays, as a linear summary on their neighbours.

        The summary holds at the neighbours' linearisation points, which are kept from then on (first estimates): moved,
        they would disagree with it about the directions that the measurements leave free. Estimates and covariances of
        what stays are as before. Memory of what leaves is used again, and so are the numbers of its
        factors; its keys cannot be.

        Parameters
        ----------
        keys : int or (N,) int
            Variables that are in the smoother and not held.

        Raises
        ------
        GraphError
            A key is unknown, left before, or is held. Nothing has changed.
        """
        self.finish()
        self._state.marginalize(keys)

    def switch(self, factors: ArrayLike, on: bool) -> None:
        """Switch factors off, or on again; the next `update` brings it in. If that one is refused, all stays as it was.

        Parameters
        ----------
        factors : (M,) int
            Numbers of factors that are in the smoother.
        on : bool
            A factor that is off keeps its number and its place in the tree, and weighs nothing.

        Raises
        ------
        GraphError
            There is no such factor.
        """
        self._state.switch(factors, on)

    def covariance(self, keys: ArrayLike) -> Array:
        """Return the covariance of one variable (d, d), or of several of one size (N, d, d).

        Of right perturbations, at the linearisation point; zero for held variables. The work is that of the cliques
        between the variables and the root.
        """
        return self._state.covariance(keys)

    def joint(self, keys: ArrayLike) -> Array:
        """Return the joint covariance (D, D) of several variables, in the order of the keys; else as `covariance`."""
        return self._state.joint(keys)

    def cliques(self) -> tuple[CliqueRecord, ...]:
        """Return the cliques of the Bayes tree, parents before their children."""
        return clique_records(self._state)

    def save(self, path: Path | str) -> None:
        """Write the whole state to a file; the smoother that `load` returns goes on to the bit as this one does.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        write_state(
            path,
            state_arrays(self._state),
            {"settings": asdict(self.settings), "updates": self._updates, "savings": self._savings.left},
        )

    @classmethod
    def load(cls, path: Path | str, *, factors: Iterable[type[Factor]] = ()) -> ISAM2:
        """Read what `save` wrote.

        Parameters
        ----------
        path : Path or str
            The file.
        factors : classes
            The user's own factors in it, found by their names: a file holds data, not programs.

        Raises
        ------
        FormatError
            The file is no such state, is damaged, or a later version wrote it.
        GraphError
            It holds factors whose class was not given, or does not fit.
        """
        state, contents = read_state(path, factors)
        return _restored(ISAM2Settings(**contents["settings"]), contents["updates"], contents["savings"], state)

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (
            self.settings,
            self._updates,
            self._savings.left,
            state_arrays(self._state),
            self._state.own_factors(),
        )

    @property
    def bytes(self) -> int:
        """Memory of the tree and its factors."""
        return int(self._state.native.bytes())

    def __contains__(self, key: object) -> bool:
        return key in self._state

    def estimate(self, keys: ArrayLike | None = None) -> Value:
        """Return the estimate: of one key a value, of several of one family a batch, without keys all `Values`."""
        return self._state.values() if keys is None else self._state.at(keys)


def _restored(settings: ISAM2Settings, updates: int, savings: list[int], state: TreeState) -> ISAM2:
    smoother = ISAM2(settings)
    smoother._state, smoother._updates, smoother._savings.left = state, updates, list(savings)
    return smoother


def _unpickled(
    settings: ISAM2Settings,
    updates: int,
    savings: list[int],
    arrays: dict[str, NDArray[Any]],
    own: tuple[type[Factor], ...],
) -> ISAM2:
    return _restored(settings, updates, savings, state_from(arrays, own))


def _sum(a: list[int], b: list[int]) -> list[int]:
    return [old + new for old, new in zip(a, b, strict=True)]


class _Savings:
    """What updates may spend on work that earlier ones put off: on relinearisation (0) and on steps (1)."""

    __slots__ = ("_limits", "left")

    def __init__(self, settings: ISAM2Settings) -> None:
        self._limits = (settings.most_relinearized, settings.most_steps)
        self.left = list(self._limits)

    def grant(self) -> None:
        """Add an update's part."""
        self.left = [min(n, left + max(n // _GRANTED, 1)) for n, left in zip(self._limits, self.left, strict=True)]

    def due(self, kind: int, wanted: int) -> int:
        """Return what may be spent now."""
        limit = self._limits[kind]
        return self.left[kind] if wanted and self.left[kind] >= min(wanted, limit // _WORTH) else 0

    def spend(self, kind: int, count: int) -> None:
        """Take off what was done."""
        self.left[kind] = max(self.left[kind] - count, 0)


class _Clock:
    """Seconds by step."""

    __slots__ = ("_last", "seconds")

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - self._last
        self._last = now
