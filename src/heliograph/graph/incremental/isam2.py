"""Incremental smoothing: iSAM2 on a Bayes tree."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.arrays import Array, Keys, Mask
from heliograph.errors import ConfigError, FormatError, GraphError
from heliograph.graph.files.archive import DAMAGE
from heliograph.graph.incremental.budget import Budget, Policy
from heliograph.graph.incremental.cliques import CliqueRecord, clique_records
from heliograph.graph.incremental.rejection import Rejection, doubtful_factors
from heliograph.graph.incremental.settings import ISAM2Settings, OutlierRejection
from heliograph.graph.incremental.tree_archive import read_state, state_arrays, state_from, write_state
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.incremental.update_result import PassTally, UpdateResult
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Value
from heliograph.graph.model.records import FactorRecord
from heliograph.graph.model.values import Values

__all__ = ["ISAM2"]

FEW_MOVED = 16  # variables: an update that moved no more, such as a step of odometry, contradicts no loop


class ISAM2:
    """A graph that grows, solved as it grows (Kaess et al., IJRR 2012).

    Parameters
    ----------
    settings : ISAM2Settings, optional
        Thresholds.
    outliers : OutlierRejection, optional
        Doubtful factors are let go where they contradict the others, and come back where they no longer do; without,
        every factor counts.

    Examples
    --------
    >>> smoother = ISAM2(outliers=OutlierRejection())
    >>> smoother.update(graph_of_the_first_pose, values_of_the_first_pose)
    >>> result = smoother.update(new_factors, new_values)
    >>> smoother.estimate(7)

    Notes
    -----
    The result does not depend on chance or time: the same updates give the same bits.
    """

    def __init__(self, settings: ISAM2Settings | None = None, *, outliers: OutlierRejection | None = None) -> None:
        self.settings = settings or ISAM2Settings()
        self._state = TreeState()
        self._policy = Policy(self.settings)
        self._rejection = None if outliers is None else Rejection(outliers)

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
        trusted: ArrayLike | None = None,
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
        trusted : (K,) int or (N,) bool, optional
            New factors that are never let go, where the smoother has `outliers`: numbers in `graph`, or a mask.
            Default: all but the between factors of keys that do not follow each other.

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
        remove = self._with_let_go(remove, remove_variables)
        leaving = state.leaving(remove_variables, remove, graph)
        doubtful = self._doubtful(graph, trusted)
        if self._rejection is not None and (np.size(remove) or state.switching):
            self._rejection.look_again()  # what contradicted a loop may be what goes
        added = state.add(graph, values, doubtful)  # (1) new variables and factors, and factors that leave
        state.remove(remove, leaving)
        before = state.cost() if costs else None
        tally.brought()
        exact = iterate is not None or (graph is None and values is None and max_variables is None)
        for budget in self._budgets(tally, exact, iterate, max_iterations, max_variables):
            self._pass(tally, budget, graph, values)
        let_go, taken_back = self._settled(tally, graph, added, doubtful, remove, iterate, max_iterations)
        policy.end_update()
        if leaving is not None:
            self.marginalize(remove_variables)
        return tally.result(
            factors=added,
            let_go=let_go,
            taken_back=taken_back,
            converged=iterate is not None and state.converged(iterate),
            pending=state.pending(),
            deferred=state.native.deferred,
            cost_before=before,
            cost_after=state.cost() if costs else None,
        )

    def _pass(
        self, tally: PassTally, budget: Budget, graph: FactorGraph | None = None, values: Values | None = None
    ) -> None:
        """Do the steps (2) to (7) once."""
        relinearized, caught_up = self._state.advance(budget, tally, graph, values)
        self._policy.spend(budget, relinearized, caught_up)

    def _doubtful(self, graph: FactorGraph | None, trusted: ArrayLike | None) -> Mask | None:
        if self._rejection is None:
            if trusted is not None:
                raise GraphError("trusted: this smoother lets nothing go; make it with outliers=OutlierRejection()")
            return None
        return None if graph is None else doubtful_factors(graph, self._state, trusted)

    def _settled(
        self,
        tally: PassTally,
        graph: FactorGraph | None,
        added: NDArray[np.int32],
        doubtful: Mask | None,
        removed: ArrayLike,
        iterate: float | None,
        max_iterations: int,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Decide about doubtful factors; return the numbers of those let go, and of those taken back."""
        none: NDArray[np.int32] = np.zeros(0, dtype=np.int32)
        if self._rejection is None:
            return none, none
        tally.begin_tests()
        self._rejection.forget(removed)
        if graph is not None and doubtful is not None:
            self._rejection.enter(self._state, graph, doubtful, added)
        elif iterate is None and tally.solved <= FEW_MOVED and self._rejection.since:
            return none, none

        def again() -> None:
            for budget in self._budgets(tally, False, iterate, max_iterations, None):
                self._pass(tally, budget)

        found = self._rejection.settle(self._state, again)
        tally.end_tests()
        return found

    def _with_let_go(self, remove: ArrayLike, variables: ArrayLike) -> ArrayLike:
        """Return the factors to be removed with those that were let go and touch variables that leave."""
        if self._rejection is None or not np.size(variables):
            return remove
        silent = self._rejection.let_go_at(self._state.numbers_in_tree(variables))
        return np.union1d(np.asarray(remove, dtype=np.int32).reshape(-1), silent)

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
        silent = self._with_let_go((), keys)
        if self._rejection is not None and np.size(silent):
            self.update(remove=silent)
        summarised = self._state.marginalize(keys)
        if self._rejection is not None:
            self._rejection.forget(summarised)

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
    def let_go(self) -> NDArray[np.int32]:
        """Numbers of the factors (K,) that are let go now, ascending; none without `outliers`."""
        none: NDArray[np.int32] = np.zeros(0, dtype=np.int32)
        return none if self._rejection is None else np.sort(self._rejection.numbers[~self._rejection.active])

    @property
    def rows_let_go(self) -> int:
        """Rows of the residuals of the factors that are let go now."""
        return 0 if self._rejection is None else int(self._rejection.rows[~self._rejection.active].sum())

    def weights(self, factors: ArrayLike) -> Array:
        """Return what factors (M,) count for, by their numbers: 1, or 0 where they are let go, (M,)."""
        return np.where(np.isin(np.asarray(factors, dtype=np.int32).reshape(-1), self.let_go), 0.0, 1.0)

    def keys_of(self, factor: int) -> Keys:
        """Return the keys of the variables that a built-in factor joins, by its number, (arity,).

        Raises
        ------
        GraphError
            There is no such factor.
        """
        return self._state.scope_of(factor)

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
        write_state(path, self._arrays(), self._about())

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
        state, arrays, about = read_state(path, factors)
        try:
            return _restored(state, arrays, about)
        except (GraphError, ConfigError, *DAMAGE) as error:
            raise FormatError(
                path, f"is no saved smoother, or damaged ({error}); save it again with ISAM2.save"
            ) from error

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as arrays by name, and what the smoother says of itself as text."""
        return {"arrays": self._arrays(), "about": json.dumps(self._about())}

    @classmethod
    def restored(cls, snapshot: Mapping[str, Any], *, factors: Iterable[type[FactorRecord]] = ()) -> ISAM2:
        """Return the smoother that `snapshot` took apart; it goes on to the same bits.

        Parameters
        ----------
        snapshot : mapping
        factors : classes
            As for `load`.

        Raises
        ------
        GraphError
            It is none, is damaged, or holds factors whose class was not given.
        """
        try:
            arrays, about = snapshot["arrays"], json.loads(snapshot["about"])
            return _restored(state_from(arrays, factors), arrays, about)
        except (ConfigError, *DAMAGE) as error:
            raise GraphError(f"the state of a smoother is damaged ({error})") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._arrays(), self._about(), self._state.custom_classes())

    def _arrays(self) -> dict[str, NDArray[Any]]:
        doubtful = {} if self._rejection is None else self._rejection.arrays()
        return {**state_arrays(self._state), **doubtful}

    def _about(self) -> dict[str, Any]:
        return {
            "settings": asdict(self.settings),
            "outliers": None if self._rejection is None else asdict(self._rejection.settings),
            "updates": self._policy.updates,
            "savings": self._policy.savings,
        }

    @property
    def bytes(self) -> int:
        """Memory of the tree and its factors."""
        return int(self._state.native.bytes())

    def __contains__(self, key: object) -> bool:
        return key in self._state

    def estimate(self, keys: ArrayLike | None = None) -> Value:
        """Return the estimate: of one key a value, of several of one family a batch, without keys all `Values`."""
        return self._state.values() if keys is None else self._state.at(keys)


def _restored(state: TreeState, arrays: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> ISAM2:
    outliers = about.get("outliers")  # an earlier version had none
    rejection = None if outliers is None else OutlierRejection(**outliers)
    smoother = ISAM2(ISAM2Settings(**about["settings"]), outliers=rejection)
    smoother._state = state
    smoother._policy.restore(about["updates"], about["savings"])
    if smoother._rejection is not None:
        smoother._rejection.restore(arrays, state)
    return smoother


def _unpickled(arrays: dict[str, NDArray[Any]], about: dict[str, Any], own: tuple[type[Factor], ...]) -> ISAM2:
    return _restored(state_from(arrays, own), arrays, about)


def _check_bound(max_variables: int | None, iterate: float | None) -> None:
    if max_variables is not None and (max_variables < 1 or iterate is not None):
        raise GraphError(f"max_variables={max_variables}: at least 1, and not together with iterate")
