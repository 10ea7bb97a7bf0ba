"""Incremental smoothing: iSAM2 on a Bayes tree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array, Keys
from heliograph.errors import GraphError
from heliograph.graph.incremental.budget import Budget, Policy
from heliograph.graph.incremental.cliques import CliqueRecord, clique_records
from heliograph.graph.incremental.settings import ISAM2Settings
from heliograph.graph.incremental.tree_archive import read_state, state_arrays, state_from, write_state
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.incremental.update_result import PassTally, UpdateResult
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Value
from heliograph.graph.model.records import FactorRecord
from heliograph.graph.model.values import Values

__all__ = ["ISAM2"]


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
        self._policy = Policy(self.settings)

    def update(
        self,
        graph: FactorGraph | None = None,
        values: Values | None = None,
        *,
        remove: ArrayLike = (),
        remove_variables: ArrayLike = (),
        iterate: float | None = None,
        max_iterations: int = 50,
        costs: bool = False,
        max_variables: int | None = None,
    ) -> UpdateResult:
        """Add factors and variables, remove factors, and bring the estimate up to date.

        Parameters
        ----------
        graph : FactorGraph, optional
            New factors, between old and new variables.
        values : Values, optional
            Where the new variables start. One that no factor touches yet waits until one does: see `early`.
        remove : (M,) int
            Numbers of factors to take out.
        remove_variables : (K,) int
            Keys of variables to take out with their last factors: all factors that touch them are in `remove`.
        iterate : float, optional
            Go on until no element of a step is longer than this [rad, m].
        max_iterations : int
            Passes that `iterate` may take.
        costs : bool
            Evaluate all factors before and after; this takes time that grows with the whole graph.
        max_variables : int, optional
            Relinearise at most this many variables, the farthest first, and eliminate at most this many (a single
            clique is not divided). What is left is ``pending``: the next updates go on with it, whatever they add.
            Meanwhile old variables keep their estimate and new ones the value they came with; steps are computed when
            the last part is done. An update without the bound does all that is pending. Not bounded: an update that
            removes or switches factors, and the ordering.

        Raises
        ------
        GraphError
            The new factors do not fit the variables; nothing has changed.
        UnderconstrainedError
            The graph would no longer determine every variable; the message names what is free. Nothing has changed, and
            the smoother can be used further.

        Notes
        -----
        The numbers are those of the steps in ``docs/theory/graph.md``.
        """
        _check_bound(max_variables, iterate)
        state, policy, tally = self._state, self._policy, PassTally()
        leaving = state.leaving(remove_variables, remove, graph)
        added = state.add(graph, values)  # (1) new variables and factors, and factors that leave
        state.remove(remove, leaving)
        before = state.cost() if costs else None
        tally.brought()
        exact = iterate is not None or (graph is None and values is None and max_variables is None)
        for budget in self._budgets(tally, exact, iterate, max_iterations, max_variables):
            relinearized, caught_up = state.advance(budget, tally, graph, values)  # (2) to (7)
            policy.spend(budget, relinearized, caught_up)
        policy.end_update()
        if leaving is not None:
            self.marginalize(remove_variables)
        return tally.result(
            factors=added,
            converged=iterate is not None and state.converged(iterate),
            pending=state.pending(),
            deferred=state.native.deferred,
            cost_before=before,
            cost_after=state.cost() if costs else None,
        )

    def _budgets(
        self, tally: PassTally, exact: bool, iterate: float | None, max_iterations: int, max_variables: int | None
    ) -> Iterator[Budget]:
        """Yield what each pass of an update may do; each is asked for when the one before is done."""
        tree, policy = self._state.native, self._policy
        yield policy.budget(tree, max_variables=max_variables, exact=exact)
        if iterate is None:
            if max_variables is None and policy.repeats(tree, tally.work, tally.solved):
                yield policy.budget(tree)
            return
        while tally.iterations < max_iterations and not self._state.converged(iterate):
            tree.find_fluid(iterate)
            yield policy.to_converge(iterate)

    def finish(self) -> None:
        """Do all that bounded updates left to be eliminated, and compute the deferred steps."""
        state = self._state
        if state.native.waiting:
            budget = self._policy.budget(state.native)
            _, caught_up = state.advance(budget._replace(relinearize=0), PassTally(), None, None)
            self._policy.spend(budget, 0, caught_up)
        state.native.finish_steps()

    def marginalize(self, keys: ArrayLike) -> None:
        """Take variables out for good; what their factors said stays, as a linear summary on their neighbours.

        The summary holds at the neighbours' linearisation points, which are kept from then on (first estimates): moved,
        they would disagree with it about the directions that the measurements leave free. Estimates and covariances of
        what stays are as before. Memory of what leaves is used again, and so are the numbers of its
        factors; its keys may be, for other variables.

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

    @property
    def early(self) -> Keys:
        """Keys of variables (K,) that have a value and no factor yet."""
        return self._state.early.values.keys()

    def covariance(self, keys: ArrayLike) -> Array:
        """Return the covariance of one variable (d, d), or of several of one size (N, d, d).

        Covariance of right perturbations at the linearisation point; zero for held variables. The work is that of the
        cliques between the variables and the root.
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
            {"settings": asdict(self.settings), "updates": self._policy.updates, "savings": self._policy.savings},
        )

    @classmethod
    def load(cls, path: Path | str, *, factors: Iterable[type[FactorRecord]] = ()) -> ISAM2:
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
            self._policy.updates,
            self._policy.savings,
            state_arrays(self._state),
            self._state.custom_classes(),
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
    smoother._state = state
    smoother._policy.restore(updates, savings)
    return smoother


def _unpickled(
    settings: ISAM2Settings,
    updates: int,
    savings: list[int],
    arrays: dict[str, NDArray[Any]],
    own: tuple[type[Factor], ...],
) -> ISAM2:
    return _restored(settings, updates, savings, state_from(arrays, own))


def _check_bound(max_variables: int | None, iterate: float | None) -> None:
    if max_variables is not None and (max_variables < 1 or iterate is not None):
        raise GraphError(f"max_variables={max_variables}: at least 1, and not together with iterate")
