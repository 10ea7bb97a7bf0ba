"""False loops let go by an incremental smoother, and decided anew where those that were let go bear each other out.

What is minimised is the truncated cost: a doubtful factor costs its squared residual, or the threshold where it is let
go. One factor at a time that minimum is known: it is taken in where its squared innovation is below the threshold [1]_,
and let go where what the others say is farther from it [2]_. Where several that were let go agree with each other, an
earlier decision may have been wrong: they are heard before those that bent the estimate, and else all doubtful factors
are weighed again by a Geman-McClure surrogate that begins convex [3]_ [4]_. Either is kept only if the truncated cost
has fallen.

References
----------
.. [1] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with applications to tracking and navigation", 2001 (gates).
.. [2] W. Baarda, "A testing procedure for use in geodetic networks", 1968 (data snooping).
.. [3] H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", RA-L
   2020.
.. [4] D. McGann, J. G. Rogers III, M. Kaess, "Robust incremental smoothing and mapping (riSAM)", ICRA 2023.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph import _core
from heliograph.arrays import Array, Mask
from heliograph.chi_square import chi_square_quantile
from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph.incremental.agreement import Loop, loop_of, squared_disagreement
from heliograph.graph.incremental.settings import OutlierRejection
from heliograph.graph.incremental.state_check import check_columns
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.outliers import geman_mcclure_weight, trusted_factors

__all__ = ["Rejection", "doubtful_factors"]

Int32s = NDArray[np.int32]
Pass: TypeAlias = Callable[[], None]  # brings what was let go and taken back into the tree

SUSPECT = 0.1  # of its threshold: a residual below which an accepted factor's innovation is not looked at
ENOUGH = 10  # accepted factors from which a scale can be told
APART = 30  # variables, at most, between the ends of loops that may bear each other out
COMPARED = 12  # loops, at most, that a new one is compared with
NEAR = 4.0  # thresholds: what misses by no more is looked at whenever it has moved
ALWAYS = 1e300
MAX_COUNT = 1 << 32  # of solves and factors: what the tree counts with has 32 bits
_COLUMNS = ("numbers", "rows", "widest", "ends", "active", "tested", "bent", "tried")

MATERIAL = 0.02  # change of a weight that is worth an elimination


def doubtful_factors(graph: FactorGraph, state: TreeState, trusted: ArrayLike | None) -> Mask | None:
    """Return which factors of an update are doubtful, (N,), or None: none of them.

    Without `trusted`, between factors of keys that do not follow each other; but the one that joins a new variable to
    the rest is trusted where nothing else does: that with the nearest key.

    Raises
    ------
    GraphError
        `trusted` names a factor that there is not, or leaves one of the user's own in doubt.
    """
    doubtful = ~trusted_factors(graph, trusted)
    if not doubtful.any():
        return None
    for added in graph.groups():
        mine = doubtful[added.first : added.first + len(added.record)]
        if mine.any() and added.record.type == 0:
            raise GraphError(f"{added.name(int(np.argmax(mine)))}: a factor of one's own cannot be doubtful; trust it")
    if trusted is None:
        _trust_links(graph, state, doubtful)
    return doubtful if doubtful.any() else None


def _trust_links(graph: FactorGraph, state: TreeState, doubtful: Mask) -> None:
    """Trust one factor of every new variable that no trusted one touches."""
    joined: set[int] = set(graph.fixed.tolist())
    links: dict[int, list[tuple[int, int]]] = {}  # new variable: distance of keys and number of each doubtful factor
    for added in graph.groups():
        for row, keys in enumerate(added.record.keys.tolist()):
            number = added.first + row
            if not doubtful[number]:
                joined.update(keys)
                continue
            for key in keys:
                if not state.in_tree(key):
                    links.setdefault(key, []).append((max(abs(key - other) for other in keys), number))
    for key, candidates in links.items():
        if key not in joined:
            nearest = min(candidates, key=lambda link: link if link[0] else (1 << 63, link[1]))
            doubtful[nearest[1]] = False


class Rejection:
    """The doubtful factors of a smoother, and which of them are let go.

    Parameters
    ----------
    settings : OutlierRejection
        Thresholds.

    Attributes
    ----------
    numbers : (M,) int32
        Their factor numbers.
    active : (M,) bool
        Those that are taken in.
    """

    def __init__(self, settings: OutlierRejection) -> None:
        self.settings = settings
        self.numbers: Int32s = np.zeros(0, dtype=np.int32)
        self.rows: Int32s = np.zeros(0, dtype=np.int32)
        self.widest: Array = np.zeros(0)  # thresholds where the noise is as it says
        self.ends: Int32s = np.zeros((0, 2), dtype=np.int32)  # lowest and highest variable
        self.active: Mask = np.zeros(0, dtype=bool)
        self.tested: Array = np.zeros(0)  # squared residual at which its innovation may pass; infinite: not looked at
        self.bent: Mask = np.zeros(0, dtype=bool)  # its residual was beyond the threshold when it was taken in
        self.tried: Int32s = np.zeros(0, dtype=np.int32)  # loops that were decided anew with it, in vain
        self.since = 0  # solve at which residuals were last looked at
        self.scale = 1.0
        self.scaled = 0  # accepted factors when the scale was last found
        self._quantiles: dict[tuple[float, int], float] = {}

    def enter(self, state: TreeState, graph: FactorGraph, doubtful: Mask, numbers: Int32s) -> None:
        """Add the doubtful factors of a graph, which have come without a say by these numbers."""
        rows = np.concatenate([np.full(len(added.record), added.record.rows) for added in graph.groups()])
        numbers = numbers[doubtful]
        scopes = [state.native.factor_data(int(number))[0] for number in numbers]
        self.numbers = np.concatenate([self.numbers, numbers])
        rows = rows[doubtful].astype(np.int32)
        bounds = [self._quantile(self.settings.probability, row) for row in rows.tolist()]
        self.rows, self.widest = np.concatenate([self.rows, rows]), np.concatenate([self.widest, bounds])
        ends = np.array([[scope.min(), scope.max()] for scope in scopes], dtype=np.int32).reshape(-1, 2)
        self.ends = np.concatenate([self.ends, ends])
        count = len(numbers)
        self.active = np.concatenate([self.active, np.zeros(count, dtype=bool)])
        self.tested = np.concatenate([self.tested, np.full(count, np.inf)])
        self.bent = np.concatenate([self.bent, np.zeros(count, dtype=bool)])
        self.tried = np.concatenate([self.tried, np.ones(count, dtype=np.int32)])

    def forget(self, numbers: ArrayLike) -> None:
        """Drop factors that leave the smoother."""
        gone = np.asarray(numbers, dtype=np.int32).reshape(-1)
        if gone.size:
            kept = ~np.isin(self.numbers, gone)
            for name in _COLUMNS:
                setattr(self, name, getattr(self, name)[kept])

    def look_again(self) -> None:
        """Have all that is let go looked at again, moved or not."""
        self.since = 0
        self.tested[~self.active] = ALWAYS

    def let_go_at(self, variables: Int32s) -> Int32s:
        """Return those that are let go and touch variables."""
        return np.asarray(self.numbers[~self.active & np.isin(self.ends, variables).any(axis=1)])

    @property
    def bounds(self) -> Array:
        """Thresholds of the squared innovations, (M,)."""
        return np.asarray(min(1.0, self.settings.scale_margin * self.scale) ** 2 * self.widest)

    def _quantile(self, probability: float, rows: int) -> float:
        key = (probability, rows)
        if key not in self._quantiles:
            self._quantiles[key] = chi_square_quantile(probability, rows)
        return self._quantiles[key]

    def settle(self, state: TreeState, again: Pass) -> tuple[Int32s, Int32s]:
        """Decide after an update; return the numbers of those let go by it, and of those taken back.

        Parameters
        ----------
        state : TreeState
            With the update's trusted factors in the tree.
        again : callable
            Makes a pass over the tree.
        """
        if state.native.waiting or not len(self.numbers):
            return self.numbers[:0], self.numbers[:0]
        before, new = self.active.copy(), np.isinf(self.tested)
        numbers = self.numbers
        self._rounds(state, again)
        fresh = np.flatnonzero(new & ~self.active)
        for index in fresh.tolist():
            cluster = self._borne_out(state, index)
            if cluster is not None:
                self._decide_anew(state, cluster, again)
        self._find_scale(state)
        went = ~self.active & (before | new)
        return np.asarray(numbers[went]), np.asarray(numbers[self.active & ~before & ~new])

    def _rounds(self, state: TreeState, again: Pass) -> None:
        """Take in what fits, and let go what does not, until nothing changes."""
        tree = state.native
        for _ in range(self.settings.max_rounds):
            squared = np.array(tree.squared(self.numbers, self.since))
            new = np.isinf(self.tested) & (squared < 0.0)
            if new.any():
                squared[new] = tree.squared(self.numbers[new], 0)
            self.since = tree.solves
            bounds = self.bounds
            moved = squared >= 0.0
            nearer = moved & ~self.active & ((squared <= self.tested) | (squared <= bounds))
            fits = self._tested(tree, np.flatnonzero(nearer), squared, bounds) <= bounds[nearer]
            back = np.flatnonzero(nearer)[fits]
            suspect = np.flatnonzero(moved & self.active & (squared > self.tested))
            excess = self._tested(tree, suspect, squared, bounds) / bounds[suspect]
            worst = suspect[[int(np.argmax(excess))]] if len(suspect) and excess.max() > 1.0 else suspect[:0]
            if not len(back) and not len(worst):
                return
            active = self.active.copy()
            self._switch(state, back, worst)
            self.tested[worst] = np.where(excess.max(initial=0.0) < NEAR, ALWAYS, bounds[worst])
            try:
                again()
            except UnderconstrainedError:  # what is let go was needed after all; the tree is as it was
                self.active = active
                return

    def _tested(self, tree: _core.BayesTree, members: NDArray[np.intp], squared: Array, bounds: Array) -> Array:
        """Return squared innovations of some factors (K,)."""
        if not len(members):
            return np.zeros(0)
        found, left = np.asarray(tree.innovations(self.numbers[members])).reshape(-1, 2).T
        ratio = bounds[members] / np.maximum(found, 1e-300)
        self.tested[members] = np.where(self.active[members] | (ratio < 1.0 / NEAR), squared[members] * ratio, ALWAYS)
        joining = ~self.active[members] & (found <= bounds[members])
        ratio = left[joining] / np.maximum(found[joining], 1e-300)
        self.tested[members[joining]] = bounds[members[joining]] * np.maximum(ratio, SUSPECT)
        self.bent[members[joining]] = squared[members[joining]] > bounds[members[joining]]
        return np.asarray(found)

    def _switch(self, state: TreeState, back: NDArray[np.intp], gone: NDArray[np.intp]) -> None:
        """Take factors back, and let others go, with the next pass."""
        state.native.take_back(self.numbers[back])
        state.native.let_go(self.numbers[gone])
        self.active[back], self.active[gone] = True, False

    def _borne_out(self, state: TreeState, index: int) -> NDArray[np.intp] | None:
        """Return a loop that was let go with those that were and agree with it, if that is worth another decision."""
        loop = loop_of(state, int(self.numbers[index]))
        if loop is None:
            return None
        apart = np.abs(self.ends - self.ends[index])
        near = np.flatnonzero(~self.active & (apart <= APART).all(axis=1))
        near = near[near != index]
        near = near[np.argsort(apart[near].sum(axis=1), kind="stable")[:COMPARED]]
        bound = float(self.bounds[index])
        agree = [k for k in near.tolist() if self._agrees(state, loop, k, bound)]
        if not agree:
            return None
        cluster = np.array([index, *agree])
        return cluster if len(cluster) >= 2 * int(self.tried[cluster].max()) else None

    def _agrees(self, state: TreeState, loop: Loop, index: int, bound: float) -> bool:
        other = loop_of(state, int(self.numbers[index]))
        return other is not None and other.ops is loop.ops and squared_disagreement(state, loop, other) <= bound

    def _decide_anew(self, state: TreeState, cluster: NDArray[np.intp], again: Pass) -> bool:
        """Hear a cluster against what contradicts it, in either way; return whether one was better."""
        before, saved, active = self._truncated_cost(state), state.native.save(), self.active.copy()
        for hear in (self._hear_first, self._hear_together):
            try:
                hear(state, cluster, again)
                self._rounds(state, again)
                self._come_to_rest(state, again)
                better = self._truncated_cost(state) < before
            except UnderconstrainedError:
                better = False
            if better:
                break
            state.restore(saved)
            self.active = active.copy()
        if not better:
            self.tried[cluster] = len(cluster)
        self.since = state.native.solves
        return better

    def _hear_first(self, state: TreeState, cluster: NDArray[np.intp], again: Pass) -> None:
        """Have loops that once bent the estimate step back until the cluster has been heard."""
        bent = np.flatnonzero(self.active & self.bent)
        self._switch(state, cluster[:0], bent)
        self.tested[bent] = ALWAYS
        again()
        self._come_to_rest(state, again)
        innovations = np.asarray(state.native.innovations(self.numbers[cluster])).reshape(-1, 2)[:, 0]
        self._switch(state, cluster[innovations <= self.bounds[cluster]], cluster[:0])
        again()
        self._come_to_rest(state, again)

    def _hear_together(self, state: TreeState, cluster: NDArray[np.intp], again: Pass) -> None:
        """Weigh all doubtful factors, the cluster among them, from convex to sharp."""
        self._switch(state, cluster, cluster[:0])
        again()
        self._come_to_rest(state, again)
        self._anneal(state, again)

    def _anneal(self, state: TreeState, again: Pass) -> None:
        tree, bounds = state.native, self.bounds
        members = np.flatnonzero(self.active)
        numbers, weights, mu = self.numbers[members], np.ones(len(members)), 0.0
        for _ in range(self.settings.max_rounds):
            squared = np.asarray(tree.squared(numbers, 0)) / bounds[members]
            mu = max(mu / self.settings.step, 1.0) if mu else max(1.0, 2.0 * float(squared.max()))
            wanted = geman_mcclure_weight(squared, mu)
            changed = np.abs(wanted - weights) > MATERIAL
            if mu == 1.0 and not changed.any():
                break
            if changed.any():
                weights[changed] = wanted[changed]
                tree.weigh_factors(numbers[changed], weights[changed])
                again()
                self._come_to_rest(state, again)
        gone = np.asarray(tree.squared(numbers, 0)) > bounds[members]
        unequal = (weights != 1.0) & ~gone
        tree.weigh_factors(numbers[weights != 1.0], np.ones(int((weights != 1.0).sum())))
        self._switch(state, members[:0], members[gone])
        if gone.any() or unequal.any():
            again()
            self._come_to_rest(state, again)

    def _come_to_rest(self, state: TreeState, again: Pass) -> None:
        """Make passes until no variable is far from where its factors were linearised."""
        for _ in range(self.settings.max_rounds):
            if not state.native.fluid:
                return
            again()

    def _truncated_cost(self, state: TreeState) -> float:
        return state.cost() + float(self.bounds[~self.active].sum())

    def _find_scale(self, state: TreeState) -> None:
        """Find the scale of accepted residuals, each time that their number has grown by a half."""
        accepted = np.flatnonzero(self.active)
        if len(accepted) < max(ENOUGH, 1.5 * self.scaled) or np.isinf(self.settings.scale_margin):
            return
        self.scaled = len(accepted)
        squared = np.asarray(state.native.squared(self.numbers[accepted], 0))
        median = np.array([self._quantile(0.5, rows) for rows in self.rows[accepted].tolist()])
        before, self.scale = self.scale, float(np.sqrt(np.median(squared / median)))
        if self.scale < before:
            self.since = 0  # all are looked at again

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return its state."""
        state: dict[str, NDArray[Any]] = {f"doubtful.{name}": getattr(self, name) for name in _COLUMNS}
        state["doubtful.when"] = np.array([self.since, self.scale, self.scaled], dtype=np.float64)
        return state

    def restore(self, arrays: Mapping[str, NDArray[Any]], state: TreeState) -> None:
        """Take a state that `arrays` returned, of a smoother with this tree; ValueError where they do not fit."""
        columns = {name: np.array(arrays[f"doubtful.{name}"]) for name in _COLUMNS}
        check_columns(columns, state)
        for name, column in columns.items():
            setattr(self, name, column)
        since, self.scale, scaled = arrays["doubtful.when"].tolist()
        if not np.isfinite([since, self.scale, scaled]).all() or self.scale < 0.0:
            raise ValueError(f"a scale of {self.scale}")
        if not (0.0 <= since < MAX_COUNT and 0.0 <= scaled < MAX_COUNT):
            raise ValueError(f"a count of {max(since, scaled, -since, -scaled):g}")
        self.since, self.scaled = int(since), int(scaled)
