"""The rounds of graduated non-convexity: weights from residuals, a few solver steps, and again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask
from heliograph.graph.batch.chordal import whitened_information
from heliograph.graph.batch.initial import choose_start
from heliograph.graph.batch.levenberg_marquardt import levenberg_marquardt
from heliograph.graph.batch.outcome import Iteration
from heliograph.graph.batch.support import Stretch, agreeing
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import FAMILIES, Family
from heliograph.graph.model.outliers import geman_mcclure_weight, truncated_weight
from heliograph.graph.model.subgraph import subgraph
from heliograph.graph.model.values import Values
from heliograph.graph.problem.linear import connected
from heliograph.graph.problem.problem import Problem
from heliograph.graph.problem.resolve import ResolvedGroup
from heliograph.graph.problem.settings import SolverSettings
from heliograph.lie import SE2, SE3, se2, se3

__all__ = ["Rounds"]


_NEGLIGIBLE = 1e-7  # weight below which a doubtful factor is left out: random pairs would fill the elimination up
_BINARY = 1e-6
_SETTLED = 1e-3  # relative change of the weighted cost
_CAUTION = 1e-6  # damping of the few steps a round: what is down-weighted must not fling anything far
_BETWEEN = 2


class Rounds:
    """A graph under re-weighting. Verbs move the values; the attributes say where they stand.

    Attributes
    ----------
    values : Values
        Now.
    squared : (N,) float64
        Squared whitened residuals of all factors there.
    weights : (N,) float64
        Last used.
    rounds, iterations : int
        So far.
    """

    def __init__(
        self, graph: FactorGraph, values: Values, known: Mask, steps: int, max_rounds: int, threads: int
    ) -> None:
        self.graph, self.values, self.known = graph, values, known
        self.steps, self.max_rounds, self.threads = steps, max_rounds, threads
        self.weights = known.astype(np.float64)
        self.rounds = self.iterations = 0
        part, self._all_numbers = subgraph(graph, np.ones(len(graph), dtype=bool), ~known)
        self._all = Problem(part, values, threads=threads)
        self._built = np.zeros(len(graph), dtype=bool)
        self._problem: Problem | None = None
        self._numbers = np.zeros(0, dtype=np.int64)
        self._measure()

    def _measure(self) -> None:
        self._all.set_values(self.values)
        self._all.cost()
        self.squared = np.zeros(len(self.graph))
        for index, group in enumerate(self._all.groups):
            self.squared[self._all_numbers[group.numbers]] = self._all.native.residuals(index)[1]

    def trusted_only(self) -> None:
        """Solve the trusted factors alone, from whatever start fits them better."""
        self._solve(self.known.astype(np.float64), SolverSettings(), start=True)

    def borne_out(self, bound: Array) -> Mask:
        """Return which doubtful relative poses agree with another one, (N,)."""
        found = np.zeros(len(self.graph), dtype=bool)
        families = self._all.families
        firsts = np.concatenate([[0], np.cumsum(self.values.counts())])
        for number, family in enumerate(families):
            if family not in (FAMILIES[SE2], FAMILIES[SE3]):
                continue
            numbers, stretch = _stretch(self._all.groups, family, int(firsts[number]))
            numbers = self._all_numbers[numbers]
            sure = self.known[numbers]
            T = family.elements(self.values.packed()[number])
            ops = se2 if family == FAMILIES[SE2] else se3
            doubtful = numbers[~sure]
            if len(doubtful):
                count = agreeing(ops, T, _part(stretch, sure), _part(stretch, ~sure), float(bound[doubtful[0]]))
                found[doubtful] = count > 0
        return found

    def graduate(self, surrogate: str, active: Mask, bound: Array, step: float, *, begin: float | None = None) -> None:
        """Weigh and solve in turn while the surrogate becomes what it stands for ([1]_ algorithm 1).

        Parameters
        ----------
        surrogate : str
            ``tls`` or ``gm``.
        active : (N,) bool
            Doubtful factors that take part; the others have no weight.
        bound : (N,) float64
            Thresholds of the squared whitened residuals.
        step : float
            Factor of the control parameter from round to round.
        begin : float, optional
            First control parameter; default: the surrogate begins convex.
        """
        if not active.any():
            return
        largest = float((self.squared / bound)[active].max())
        tls = surrogate == "tls"
        mu = begin if begin is not None else (1.0 / max(2.0 * largest - 1.0, 1e-6) if tls else max(2.0 * largest, 1.0))
        settings = SolverSettings(max_iterations=self.steps, relative_decrease=_SETTLED, initial_damping=_CAUTION)
        cost = np.inf
        for _ in range(self.max_rounds):
            squared = (self.squared / bound)[active]
            weights = self.known.astype(np.float64)
            weights[active] = truncated_weight(squared, mu) if tls else geman_mcclure_weight(squared, mu)
            before, (cost, _) = cost, self._solve(weights, settings)
            self.rounds += 1
            soft = weights[active]
            if tls and np.all((soft < _BINARY) | (soft > 1.0 - _BINARY)):
                return
            if not tls and mu <= 1.0 and abs(before - cost) <= _SETTLED * cost:
                return
            mu = mu * step if tls else max(mu / step, 1.0)

    def settle(self, bound: Array) -> tuple[Mask, str]:
        """Solve with hard inliers until they are the same twice; return them and the solver's last word."""
        status = "max_iterations"
        inliers = self.known | (self.squared <= bound)
        for _ in range(10):
            _, status = self._solve(inliers.astype(np.float64), SolverSettings(relative_decrease=1e-7))
            self.rounds += 1
            again = self.known | (self.squared <= bound)
            if np.array_equal(again, inliers):
                break
            inliers = again
        return inliers, status

    def _solve(self, weights: Array, settings: SolverSettings, *, start: bool = False) -> tuple[float, str]:
        """Move the values by a few steps under weights; return the weighted cost and the status."""
        active = weights > _NEGLIGIBLE
        stale = (active & ~self._built).any() or self._built.sum() > 1.2 * active.sum() + 50
        if self._problem is None or stale:
            part, self._numbers = subgraph(self.graph, active, ~self.known)
            _ground(part, self.values)
            self._problem = Problem(part, self.values, threads=self.threads)
            self._problem.analyze(settings.ordering)
            self._built = active
        problem = self._problem
        problem.set_values(self.values)
        for index, group in enumerate(problem.groups):
            problem.native.set_weights(index, np.ascontiguousarray(weights[self._numbers[group.numbers]]))
        first = problem.linearize()
        if start:
            first = choose_start(problem, self.values, "auto", first).cost
        found = levenberg_marquardt(problem, settings, first, _ignore)
        self.iterations += len(found.iterations)
        self.values, self.weights = problem.values(), weights
        self._measure()
        return found.cost, found.status


def _ignore(_: Iteration) -> None:
    pass


def _ground(part: FactorGraph, values: Values) -> None:
    """Hold what no factor touches, and one variable of each component that nothing absolute touches."""
    count = sum(values.counts())
    absolute, touched = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    ends: list[NDArray[np.int64]] = [np.zeros((0, 2), dtype=np.int64)]
    for record in part:
        dense = values.dense(record.keys)
        touched[dense] = True
        if record.arity == 1:
            absolute[dense] = True
        ends.extend(np.stack([dense[:, 0], dense[:, k]], axis=1) for k in range(1, record.arity))
    absolute[values.dense(part.fixed)] = True
    i, j = np.concatenate(ends).T
    label = connected(count, i, j)
    loose = ~np.isin(label, label[absolute]) & ((label == np.arange(count)) | ~touched)
    part.fix(values.keys()[loose])


def _stretch(groups: list[ResolvedGroup], family: Family, first: int) -> tuple[NDArray[np.int64], Stretch]:
    """Return the numbers and the measurements of the between factors of a family."""
    wanted = (_BETWEEN, (family, family), family.dof)  # measured whole
    mine = [group for group in groups if (group.code, group.families, group.rows) == wanted]
    if not mine:
        none = np.zeros(0, dtype=np.int64)
        Z, omega = np.zeros((0, *family.shape)), np.zeros((0, family.dof, family.dof))
        return none, Stretch(i=none, j=none, T_i_j=Z, information=omega)
    ends = np.concatenate([group.variables for group in mine]).astype(np.int64) - first
    return np.concatenate([group.numbers for group in mine]), Stretch(
        i=ends[:, 0],
        j=ends[:, 1],
        T_i_j=np.concatenate([family.elements(group.measurement) for group in mine]),
        information=np.concatenate([whitened_information(g.noise, g.rows, len(g.variables)) for g in mine]),
    )


def _part(stretch: Stretch, mask: Mask) -> Stretch:
    return Stretch(
        i=stretch.i[mask], j=stretch.j[mask], T_i_j=stretch.T_i_j[mask], information=stretch.information[mask]
    )
