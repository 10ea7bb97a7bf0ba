"""The Bayes tree with keys, families and factor numbers: what `ISAM2` keeps between updates."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, Keys, Mask
from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph.diagnosis.diagnosis import diagnose
from heliograph.graph.incremental.budget import UNBOUNDED, Budget
from heliograph.graph.incremental.early import EarlyVariables
from heliograph.graph.incremental.staging import FactorStage, Staged
from heliograph.graph.incremental.update_result import PassTally
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factor_graph import Added, FactorGraph
from heliograph.graph.model.factors import Prior
from heliograph.graph.model.families import Family, Value
from heliograph.graph.model.key_runs import KeyRuns
from heliograph.graph.model.noise import Isotropic
from heliograph.graph.model.records import as_keys, key_list
from heliograph.graph.model.symbols import key_name
from heliograph.graph.model.values import Values

__all__ = ["TreeState"]

Int32s = NDArray[np.int32]


class TreeState:
    """Names for what the native tree numbers, and checks before anything is handed to it."""

    def __init__(self) -> None:
        self.native = _core.BayesTree()
        self._number: dict[int, int] = {}  # of a key's variable
        self._keys: list[int] = []  # by variable; numbers of variables that left are given again
        self._families: list[Family] = []
        self._left = KeyRuns()
        self.staging = FactorStage(self.native, self._families)
        self.early = EarlyVariables()
        self._switched: dict[int, float] = {}  # weights that the next update brings in
        # The update that is under way adds these variables and custom factors, and removes these factors.
        self._fresh: set[int] = set()
        self._entered: list[int] = []
        self._removed: list[int] = []
        self._made = False  # a pass of it has ended

    def add(self, graph: FactorGraph | None, values: Values | None, let_go: Mask | None = None) -> Int32s:
        """Hand new variables and factors to the tree; return the factors' numbers. On an error nothing has changed.

        Those in the mask `let_go` (N,) get a number, and say nothing until they are taken back.
        """
        graph = FactorGraph() if graph is None else graph  # one without factors may hold variables
        values = Values() if values is None else values
        self._made = False
        keys = [key for mine in values.keys_by_family() for key in mine]
        self._check_new(keys)
        groups = graph.groups()
        named = [added.record.flat_keys() for added in groups]
        self._add_variables(self.early.enter(graph, values, keys, named))
        staged: list[Staged] = []
        try:
            for added, mine in zip(groups, named, strict=True):
                if mine:
                    staged += self.staging.parts(added, self._numbers_of(mine, added), let_go)
            held = self._held(graph.fixed)
        except GraphError:
            self.roll_back()
            raise
        if held is not None:
            self.native.hold(held)
        return self._enter(staged, len(graph))

    def _enter(self, staged: list[Staged], count: int) -> Int32s:
        """Hand factors over and return their numbers, in the order of the graph's."""
        # One each, and so in order: what an online graph adds.
        if len(staged) == count and not self.staging.custom.kinds:
            return self.native.add_single_factors(staged)
        numbers = np.zeros(count, dtype=np.int32)
        for part in staged:
            numbers[part.rows] = self._add_factors(part)
        return numbers

    def _check_new(self, keys: list[int]) -> None:
        known = [key for key in keys if key in self._number]
        if known:
            raise GraphError(
                f"{key_list(np.array(known))}: already in the smoother; give a value once, when a variable is new"
            )
        if len(self.early.values):
            twice = [key for key in keys if key in self.early.values]
            if twice:
                raise GraphError(f"{key_list(np.array(twice))}: has a value already and waits for its first factor")

    def _add_variables(self, values: Values) -> None:
        keys, families, number = self._keys, self._families, self._number
        for family, packed, mine in zip(values.families(), values.packed(), values.keys_by_family(), strict=True):
            added = self.native.add_variables(family.code, family.dof, packed.reshape(-1)).tolist()
            for variable, key in zip(added, mine, strict=True):
                if variable == len(keys):
                    keys.append(key)
                    families.append(family)
                keys[variable] = key
                number[key] = variable
            self._fresh.update(added)

    def roll_back(self) -> None:
        """Undo what the update that is under way has brought: everything is as it was before."""
        self.native.undo()
        self._roll_back_names()

    def _roll_back_names(self) -> None:
        for number in sorted(self._fresh, reverse=True):
            del self._number[self._keys[number]]
            if number >= self.native.slots:
                del self._keys[number], self._families[number]
        self.staging.custom.drop(self._entered)
        self.early.roll_back()
        self._end_update()

    def _commit_names(self) -> None:
        self.staging.custom.drop(self._removed)
        self.early.commit()
        self._made = True
        self._end_update()

    def _end_update(self) -> None:
        self._fresh.clear()
        self._entered, self._removed, self._switched = [], [], {}

    def advance(
        self, budget: Budget, tally: PassTally, graph: FactorGraph | None, values: Values | None
    ) -> tuple[int, int]:
        """Do one pass; return how many variables were relinearised, and how many deferred steps were computed.

        Long steps go into the linearisation points, the top of the tree is taken down, ordered with the newest last and
        eliminated; steps are carried down. When the elimination is done the update is in the tree for good.

        Parameters
        ----------
        budget : Budget
            What the pass may do.
        tally : PassTally
            Receives what it did, and its seconds.
        graph, values : FactorGraph and Values, or None
            What the update brought, for a message.

        Raises
        ------
        UnderconstrainedError
            Something is not determined; the update is undone.
        """
        if self.staging.custom.kinds:
            return self._advance_by_steps(budget, tally, graph, values)
        done = self.native.advance(
            budget.threshold,
            budget.relinearize,
            budget.farthest_first,
            budget.eliminate,
            budget.wildfire,
            budget.fluid_threshold,
            budget.steps,
            budget.deferred_steps,
        )
        self._decide(done.undetermined, graph, values)
        tally.add(done.relinearized, self.native.counts(), done.seconds)
        return done.relinearized, done.caught_up

    def _advance_by_steps(
        self, budget: Budget, tally: PassTally, graph: FactorGraph | None, values: Values | None
    ) -> tuple[int, int]:
        """Do one pass as `advance`, with the user's own factors evaluated between two of its steps."""
        native, laps = self.native, [time.perf_counter()]
        relinearized = 0
        if budget.relinearize:
            relinearized = native.relinearize(budget.threshold, budget.relinearize, budget.farthest_first)
        laps.append(time.perf_counter())
        self.detach()
        laps.append(time.perf_counter())
        native.reorder()
        laps.append(time.perf_counter())
        self._decide(native.eliminate(budget.eliminate), graph, values)
        laps.append(time.perf_counter())
        caught_up = 0
        if not native.waiting:
            caught_up = native.solve(budget.wildfire, budget.fluid_threshold, budget.steps, budget.deferred_steps)
        laps.append(time.perf_counter())
        tally.add(relinearized, native.counts(), [after - before for before, after in pairwise(laps)])
        return relinearized, caught_up

    def _decide(self, undetermined: int, graph: FactorGraph | None, values: Values | None) -> None:
        """Take the update for good, or say why it was refused at a variable."""
        if undetermined >= 0:
            raise UnderconstrainedError(self._refused(undetermined, graph, values))
        self._commit_names()

    def detach(self) -> None:
        """Take down the top of the tree, and evaluate the user's own factors in it that have to be linearised."""
        self.native.detach()
        try:
            for kind, own in self.staging.custom:
                numbers = self.native.stale_factors(kind)
                if numbers.size:
                    self.native.set_custom(*own.evaluate(numbers, self.native.linearization_point))
        except GraphError:
            self.roll_back()
            raise

    def converged(self, threshold: float | None) -> bool:
        """Return whether no step is longer than a threshold [rad, m], or without one whether nothing is left to do."""
        if threshold is not None:
            return self.native.largest_step() <= threshold
        return not self.pending()

    def numbers_in_tree(self, keys: ArrayLike) -> Int32s:
        """Return the numbers of those keys that are in the tree."""
        known = [self._number.get(key, -1) for key in as_keys(keys).reshape(-1).tolist()]
        return np.array([number for number in known if number >= 0], dtype=np.int32)

    def marginalize(self, keys: ArrayLike) -> list[int]:
        """Take variables out of the tree; what their factors said stays as a summary. Returns the factors' numbers."""
        leaving = as_keys(keys).reshape(-1)
        early = [key for key in leaving.tolist() if key in self.early.values]
        numbers = self._numbers(leaving[~np.isin(leaving, early)], lambda: "to be marginalised out")
        held = [self._keys[number] for number in numbers.tolist() if self.native.held(number)]
        if held:
            raise GraphError(f"{key_list(np.array(held))}: held by `fix`; what is known is not marginalised out")
        self.early.drop(early)
        if not numbers.size:
            return []
        self.native.leave(numbers)
        self.detach()
        self.native.reorder()
        failed = self.native.eliminate(UNBOUNDED)
        if failed >= 0:
            name = key_name(self._keys[failed])
            raise UnderconstrainedError(
                f"key {name}: not determined where it was last linearised; nothing was marginalised out"
            )
        summarised: list[int] = self.native.drop_left().tolist()
        self.staging.custom.drop(summarised)
        for number in summarised:
            self._switched.pop(number, None)
        for number in numbers.tolist():
            key = self._keys[number]
            self._number.pop(key, None)
            self._left.add(key)
        return summarised

    def pending(self) -> int:
        """Return how many variables wait to be eliminated, else relinearised, else how many branches are deferred."""
        return int(self.native.waiting or self.native.fluid or self.native.deferred)

    def _nothing_waiting(self) -> None:
        if self.native.waiting:
            raise GraphError(
                f"{self.native.waiting} variables wait to be eliminated after a bounded update; call `finish` first"
            )

    def __contains__(self, key: object) -> bool:
        return key in self._number or key in self.early.values

    def held(self, key: int) -> bool:
        """Return whether a variable is held at its value."""
        return key in self._number and bool(self.native.held(self._number[key]))

    def leaving(self, keys: ArrayLike, removed: ArrayLike, added: FactorGraph | None) -> FactorGraph | None:
        """Return what holds variables in place of factors that are removed, until they leave; None: there are none.

        Raises
        ------
        GraphError
            A key is unknown or held, or has factors that are not removed or that are added.
        """
        asked = as_keys(keys).reshape(-1)
        if not asked.size:
            return None
        self._nothing_waiting()
        asked = asked[[key not in self.early.values for key in asked.tolist()]]  # what has no factor just goes
        numbers = self._numbers(asked, lambda: "to be removed")
        for new in () if added is None else added.groups():
            touched = np.isin(new.record.keys, asked)
            if touched.any():
                raise GraphError(f"{new.name(int(np.argmax(touched.any(axis=1))))}: joins a variable that is removed")
        going, graph = set(np.asarray(removed, dtype=np.int64).reshape(-1).tolist()), FactorGraph()
        for key, number in zip(asked.tolist(), numbers.tolist(), strict=True):
            if self.native.held(number):
                raise GraphError(f"key {key_name(key)}: held by `fix`; what is known is not removed")
            stay = sorted(set(self.native.factors_of(number).tolist()) - going)
            if stay:
                raise GraphError(
                    f"key {key_name(key)}: still has the factors {', '.join(map(str, stay[:8]))}; remove them with it, "
                    "or marginalise it out"
                )
            graph.add(Prior(key, self.at(key), Isotropic(1.0)))
        return graph

    def _hold_leaving(self, graph: FactorGraph) -> None:
        """Give what `leaving` returned to the update that is under way."""
        for added in graph.groups():
            for part in self.staging.parts(added, self._numbers_of(added.record.flat_keys(), added)):
                self._add_factors(part)

    def _held(self, keys: NDArray[np.int64]) -> Int32s | None:
        if not keys.size:
            return None
        held = self._numbers(keys, lambda: "held by `fix`")
        if not self._fresh.issuperset(held.tolist()):
            raise GraphError(f"{key_list(keys)}: only variables that are new in an update can be held")
        return held

    def _numbers(self, keys: NDArray[np.int64], what: Callable[[], str]) -> Int32s:
        """Return the numbers of the variables, of the keys' shape; `what` tells a message what names them."""
        numbers = [self._number.get(key, -1) for key in keys.ravel().tolist()]
        if -1 in numbers:
            raise GraphError(self._missing(keys.ravel(), what()))
        return np.array(numbers, dtype=np.int32).reshape(keys.shape)

    def _numbers_of(self, keys: list[int], added: Added) -> list[int]:
        """Return the numbers of a record's variables."""
        numbers = [self._number.get(key, -1) for key in keys]
        if -1 in numbers:
            what = f"in {added.name(0)} and what follows it"
            raise GraphError(self._missing(np.array(keys, dtype=np.int64), what))
        return numbers

    def _missing(self, keys: NDArray[np.int64], what: str) -> str:
        """Return what is wrong with the first kind of keys (N,) that are not in the tree."""
        left = keys[[key in self._left and key not in self._number for key in keys.tolist()]]
        if left.size:
            return f"{key_list(left)}: {what}, but marginalised out; name only keys that are kept"
        missing = keys[[key not in self._number for key in keys.tolist()]]
        early = missing[[key in self.early.values for key in missing.tolist()]]
        if early.size:
            return f"{key_list(early)}: {what}, but without a factor so far; add one first"
        return f"{key_list(missing)}: {what}, but without a value; insert one with the factor"

    def _add_factors(self, part: Staged) -> Int32s:
        numbers, entered = self.staging.hand_over(part)
        self._entered += entered
        return numbers

    def remove(self, numbers: ArrayLike, leaving: FactorGraph | None = None) -> None:
        """Take factors out, and bring in what was switched, with the next elimination; `leaving` as it returned it."""
        if leaving is not None:
            self._hold_leaving(leaving)
        if isinstance(numbers, tuple) and not numbers and not self._switched:
            return
        array = np.asarray(numbers, dtype=np.int32).reshape(-1)
        try:
            if array.size:
                self.native.remove_factors(array)
                self._removed = array.tolist()
            kept = {number: weight for number, weight in self._switched.items() if number not in self._removed}
            if kept:
                self.native.weigh_factors(np.array(list(kept), dtype=np.int32), np.array(list(kept.values())))
        except ValueError as error:
            self.roll_back()
            raise GraphError(f"factors {key_list(array)}: {error}; nothing was changed") from error

    def switch(self, numbers: ArrayLike, on: bool) -> None:
        """Note what the next update switches on or off."""
        array = np.asarray(numbers, dtype=np.int32).reshape(-1)
        if not self.native.has_factors(array):
            raise GraphError(f"factors {key_list(array)}: not all of them are in the smoother; nothing was switched")
        self._switched.update(dict.fromkeys(array.tolist(), 1.0 if on else 0.0))

    def restore(self, saved: bytes) -> None:
        """Put the tree back to what `native.save` said, of the same variables and factors."""
        self.native = self.staging.native = _core.BayesTree()
        self.native.load(saved)

    def scope_of(self, number: int) -> Keys:
        """Return the keys of the variables that a built-in factor joins."""
        if not self.native.has_factors(np.array([number], dtype=np.int32)):
            raise GraphError(f"factor {number}: not in the smoother")
        return self.key_of(self.native.factor_data(number)[0])

    def in_tree(self, key: int) -> bool:
        """Return whether a variable has been brought into the tree."""
        return key in self._number

    def family_of(self, number: int) -> Family:
        """Return the family of one of the native side's variables."""
        return self._families[number]

    @property
    def switching(self) -> bool:
        """The next update switches factors on or off."""
        return bool(self._switched)

    def cost(self) -> float:
        """Return the cost of all factors at the estimate, but those that were let go."""
        self.native.finish_steps()
        for _, own in self.staging.custom:
            numbers = np.array(sorted(own.scopes), dtype=np.int32)
            if numbers.size:
                self.native.set_custom(*own.evaluate(numbers, self.native.estimate))
        return self.native.cost()

    def _refused(self, variable: int, graph: FactorGraph | None, values: Values | None) -> str:
        """Return why an update was refused, and drop its variables; the tree has undone the rest."""
        name = key_name(self._keys[variable])
        if self._made:
            return (
                f"key {name}: not determined where the update has moved it; it was made, but not repeated from there: "
                "look at its measurements, and remove its factors by their numbers"
            )
        text = f"the update would leave key {name} undetermined; it was not made, and the smoother stays as it was"
        if values is not None and variable in self._fresh:
            text = self._free(FactorGraph() if graph is None else graph, values) or text
        self._roll_back_names()
        return text

    def _free(self, graph: FactorGraph, values: Values) -> str | None:
        """Return what is free of the new variables if all old ones are taken as known."""
        local, start, old = graph.copy(), Values(), []
        fresh = [self._keys[number] for number in self._fresh]
        keys = np.unique(np.concatenate([fresh, *(added.record.keys.reshape(-1) for added in graph.groups())]))
        for key in keys.astype(np.int64).tolist():
            if self._number[key] in self._fresh:
                start.insert(key, (values if key in values else self.early.values).at(key))
            else:
                start.insert(key, self.at(key))
                old.append(key)
        local.fix(np.array(old, dtype=np.int64))
        found = diagnose(local, start)
        return None if found.ok else f"{found.message}; the update was not made, and the smoother stays as it was"

    def covariance(self, keys: ArrayLike) -> Array:
        """Return the covariance of one variable (d, d), or of several of one size (N, d, d)."""
        self._nothing_waiting()
        array = as_keys(keys)
        numbers = self._numbers(array.reshape(-1), lambda: "asked for")
        if not numbers.size:
            return np.zeros((0, 0, 0))
        dofs = {self._families[v].dof for v in numbers.tolist()}
        if len(dofs) > 1:
            raise GraphError(
                f"{key_list(array)}: variables of {min(dofs)} and of {max(dofs)} degrees of freedom; "
                "ask for one size at a time"
            )
        d = dofs.pop()
        out = self.native.covariance(numbers).reshape(-1, d, d)
        out = 0.5 * (out + np.swapaxes(out, 1, 2))
        return np.asarray(out[0] if array.ndim == 0 else out)

    def joint(self, keys: ArrayLike) -> Array:
        """Return the joint covariance (D, D) of several variables, in the order of the keys."""
        self._nothing_waiting()
        numbers = self._numbers(as_keys(keys).reshape(-1), lambda: "asked for")
        out = self.native.joint_covariance(numbers)
        size = int(np.sqrt(out.size))
        out = out.reshape(size, size)
        return np.asarray(0.5 * (out + out.T))

    def custom_classes(self) -> tuple[type[Factor], ...]:
        """Return the classes of the user's own factors, each once."""
        return self.staging.custom.classes()

    def key_of(self, numbers: Int32s) -> NDArray[np.int64]:
        """Return the keys of the native side's variables."""
        return np.array([self._keys[v] for v in numbers.tolist()], dtype=np.int64)

    def at(self, keys: ArrayLike) -> Value:
        """Return the estimate of keys of one family: a lie value or an array."""
        array = as_keys(keys)
        if len(self.early.values) and all(key in self.early.values for key in array.reshape(-1).tolist()):
            return self.early.values.at(keys)
        numbers = self._numbers(array.reshape(-1), lambda: "asked for")
        family = self._families[numbers[0]]
        if any(self._families[v] is not family and self._families[v] != family for v in numbers.tolist()):
            raise GraphError(f"{key_list(array)}: of several families; ask for one at a time")
        elements = family.elements(self.native.estimate(numbers).reshape(-1, family.storage))
        return family.wrap(elements[0] if array.ndim == 0 else elements)

    def values(self) -> Values:
        """Return the estimate of every variable."""
        values = Values()
        order: dict[Family, list[int]] = {}
        for number in self._number.values():
            order.setdefault(self._families[number], []).append(number)
        keys = np.array(self._keys, dtype=np.int64)
        for family, members in order.items():
            numbers = np.array(members, dtype=np.int32)
            values.insert(keys[numbers], family.unpack(self.native.estimate(numbers).reshape(-1, family.storage)))
        for family in self.early.values.families():
            values.insert(*self.early.values.block(family))
        return values
