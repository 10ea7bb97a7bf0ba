"""Diagnosis: what a graph leaves undetermined, found before anything is factorised, and said in words."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph import _core
from heliograph.arrays import Array, Indices
from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph.diagnosis.free_motion import FreeMotion, describe_free, named_keys, remedy_for
from heliograph.graph.diagnosis.null_space import Sensitivities
from heliograph.graph.diagnosis.world_motions import world_motions
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.families import Family
from heliograph.graph.model.values import Values
from heliograph.graph.problem.problem import Problem

__all__ = ["Diagnosis", "diagnose", "inspect", "require_determined", "require_solved"]


_MAX_COLUMNS = 48  # seed directions of one part
_MAX_PARTS = 50  # that are told one by one
_MAX_TOLD = 6  # in a message
_TURN = 0.3  # of the perturbation that tells structure from accident [rad, and of the extent]
_DAMPING = 1e-13  # of the diagonal, for the inverse iteration
_SURE = 1e-7  # least pivot, of the diagonal it came from, above which nothing is free: rounding leaves 1e-10 of nothing
_UNDAMPED = 1e-3 * _SURE  # damping that does not lift a pivot to that
_GENTLE, _POLISH = 1e-9, 4  # damping and number of the steps that end a search to rounding
_COLUMNS, _ROUNDS = 8, 3  # of the inverse iteration
_DETERMINED, _FOLLOWS, _UNRESOLVED = 0, 1, 2  # as the native side numbers them


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What a graph determines and what not, linearised at some values.

    Parameters
    ----------
    free : tuple of FreeMotion
        What is undetermined, if anything.
    components : int
        Connected components of the graph, held variables included; a variable without factors is one. 0: not counted.
    complete : bool
        Nothing else can be free. False where the graph is too entangled to decide that without factorising it.
    everywhere : bool
        Everything is determined whatever the values are.
    close : bool
        Nothing is free, but something so nearly that it took a second look.
    """

    free: tuple[FreeMotion, ...]
    components: int = 0
    complete: bool = True
    everywhere: bool = False
    close: bool = False

    @property
    def ok(self) -> bool:
        """Nothing was found free."""
        return not self.free

    @property
    def message(self) -> str:
        """All of it in one sentence, with the remedies."""
        if self.ok:
            return "the graph determines every variable"
        scalars = sum(motion.scalars for motion in self.free)
        parts = []
        for motion in self.free[:_MAX_TOLD]:
            where = f" (component {motion.component + 1} of {self.components})" if self.components > 1 else ""
            parts.append(f"{motion.text}{where}: {motion.remedy}")
        more = f"; and {len(self.free) - _MAX_TOLD} more" if len(self.free) > _MAX_TOLD else ""
        plural = "degree" if scalars == 1 else "degrees"
        return f"the graph leaves {scalars} {plural} of freedom undetermined: " + "; ".join(parts) + more


def diagnose(graph: FactorGraph, values: Values) -> Diagnosis:
    """Say what a graph leaves undetermined.

    Parameters
    ----------
    graph : FactorGraph
        The factors, and which variables are held. Robust kernels do not count: no factor is taken for rejected.
    values : Values
        Where to linearise.

    Returns
    -------
    Diagnosis
        Free motions by component and by degree of freedom.

    Raises
    ------
    GraphError
        The graph does not fit the values, or a residual is not finite.

    Notes
    -----
    What is held determines its neighbours, they theirs, and so on. Each connected part that is left is moved by a few
    seeds; motions of a part that no factor resists are free. Parts that would need too many seeds are factorised, and
    vectors near the null space come from inverse iteration. A motion is called free only if not one factor resists it
    by more than rounding, so weak information is never taken for none.
    """
    problem = Problem(graph, values)
    problem.check_finite(problem.linearize())
    found = inspect(problem)
    if found.ok and not found.complete:
        problem.analyze()
        problem.linearize()
        found = inspect(problem, factorize=True)
    return replace(found, components=_core.graph_components(problem.native))


def require_determined(problem: Problem) -> Diagnosis:
    """Raise `UnderconstrainedError` if a linearised problem leaves anything free at any values; nothing is factorised.

    Returns
    -------
    Diagnosis
        At the present values. It may name motions that are free only there, such as turns of poses whose landmarks all
        start at the origin; a solver leads away from such values, so the end is what counts.
    """
    found = inspect(problem)
    if found.ok:
        return found
    elsewhere = _inspect_elsewhere(problem)
    if elsewhere is None or elsewhere.ok:
        return found
    stays = np.unique(np.concatenate([motion.keys for motion in elsewhere.free]))
    free = tuple(motion for motion in found.free if np.isin(motion.keys, stays).any())
    raise_free(replace(found, free=free or elsewhere.free))
    return found


def raise_free(found: Diagnosis) -> None:
    """Raise `UnderconstrainedError` unless nothing is free."""
    if not found.ok:
        raise UnderconstrainedError(found.message, found)


def _inspect_elsewhere(problem: Problem) -> Diagnosis | None:
    """Return the diagnosis at values far from the present ones, or None where they cannot be evaluated."""
    saved = problem.native.values()
    rng = np.random.default_rng(0)
    steps = []
    for family, packed in zip(problem.families, problem.values().packed(), strict=True):
        step = rng.normal(scale=_TURN, size=(len(packed), family.dof))
        if family.space or family.lie is None:
            at = packed if family.lie is None else family.elements(packed)[:, : family.space, family.space]
            spread = float(np.ptp(at, axis=0).max(initial=0.0))
            turns = 0 if family.lie is None else 1 if family.space == 2 else 3
            step[:, turns:] *= spread or 1.0
        steps.append(step.reshape(-1))
    problem.native.set_step(np.concatenate(steps))
    problem.native.retract()
    problem.accept()
    # held variables stay where they are: their step does nothing to what is determined by them
    try:
        finite = np.isfinite(problem.linearize().cost)
        return inspect(problem) if finite else None
    except GraphError:
        return None
    finally:
        problem.native.set_values(saved)
        problem.linearize()


def require_solved(problem: Problem, *, before: Diagnosis, failed: bool) -> Diagnosis:
    """Raise `UnderconstrainedError` if a solved problem's values are not determined by all of its factors.

    Parameters
    ----------
    problem : Problem
        At its last values.
    before : Diagnosis
        Diagnosis of the start.
    failed : bool
        The normal equations had no Cholesky factor.

    Returns
    -------
    Diagnosis
        Without the factors that their robust kernels reject altogether: what only those held is named there as free.
    """
    rejecting = any(group.kernel is not None for group in problem.groups)
    if before.everywhere and not rejecting and not failed:
        return before
    constrained = any(group.constrained for group in problem.groups)
    plain = before.ok and before.complete and not (rejecting or failed or constrained)
    # The last factorisation was a step from the end; what it shows beyond doubt needs no search.
    if plain and problem.damping <= _UNDAMPED and _core.graph_least_pivot(problem.native) > _SURE:
        return before
    problem.linearize()
    factorize = True if failed else None
    found = inspect(problem, weighted=True, factorize=factorize)
    if not found.ok:
        raise_free(inspect(problem, factorize=factorize))
    elif found.close and not failed:
        _require_determined_nearby(problem)
    return found


def _require_determined_nearby(problem: Problem) -> None:
    """Raise `UnderconstrainedError` if further steps lead to values at which something is free.

    Where a solver stops it is a little off the optimum, and a motion that is free there is not quite so here.
    """
    saved, cost = problem.native.values(), problem.cost().cost
    for _ in range(_POLISH):
        if problem.factorize(_GENTLE, np.finfo(float).tiny) is not None:
            break
        problem.linear_step(_GENTLE, np.finfo(float).tiny)
        trial = problem.try_step().cost
        if not trial <= cost * (1.0 + 1e-6):
            break
        cost = trial
        problem.accept()
        problem.linearize()
    found = inspect(problem)
    problem.native.set_values(saved)
    raise_free(found)


def inspect(problem: Problem, *, weighted: bool = False, factorize: bool | None = False) -> Diagnosis:
    """Return the diagnosis of a linearised problem.

    Parameters
    ----------
    problem : Problem
        Linearised; analysed where `factorize` is set.
    weighted : bool
        Factors that a robust kernel rejects count for nothing.
    factorize : bool or None
        Look for null vectors by inverse iteration; None: only where the graph is too entangled to decide without.
    """
    return _Search(problem, weighted=weighted).run(factorize=factorize)


class _Space:
    """What the native search found; see cpp/graph/diagnosis/diagnosis.hpp."""

    def __init__(self, problem: Problem, assumed: Indices) -> None:
        found = _core.graph_free_space(problem.native, assumed.astype(np.int32), _MAX_COLUMNS)
        self.determined: bool = found[0]
        self.everywhere: bool = found[1]
        self.components: int = found[2]
        self.component, self.factors, self.freedom, self.part, self.columns, self.motion_of, self.motion = found[3:]

    def parts(self) -> list[Indices]:
        """Return the variables of each part, ascending."""
        moving = np.flatnonzero(self.part >= 0)
        order = moving[np.argsort(self.part[moving], kind="stable")]
        return np.split(order, np.cumsum(np.bincount(self.part[moving], minlength=len(self.columns)))[:-1])

    def motion_of_part(self, variables: Indices, dofs: Indices, columns: int) -> Array:
        """Return how variables move with their seeds, (T, columns)."""
        at = np.concatenate(
            [np.arange(o, o + d * columns) for o, d in zip(self.motion_of[variables], dofs, strict=True)]
        )
        return np.asarray(self.motion[at].reshape(-1, columns))


class _Search:
    def __init__(self, problem: Problem, *, weighted: bool) -> None:
        self.problem = problem
        self.weighted = weighted
        self.free: list[FreeMotion] = []

    def run(self, *, factorize: bool | None) -> Diagnosis:
        space = _Space(self.problem, np.zeros(0, dtype=np.int64))
        self.space = space
        if space.determined:
            return Diagnosis(free=(), everywhere=space.everywhere)
        problem = self.problem
        self.sensitivities = Sensitivities(problem, weighted=self.weighted)
        self.keys = problem.start.keys()
        self.packed = problem.values().packed()
        self.bounds = np.cumsum([0, *problem.start.counts()])
        self._without_factor()
        unresolved = self._parts(space)
        if unresolved:
            self._unresolved(unresolved)
        if (factorize or (factorize is None and unresolved)) and not self.free:
            everything = unresolved or [np.setdiff1d(np.arange(len(self.keys)), problem.held)]
            self._iterate(np.sort(np.concatenate(everything)))
        order = sorted(self.free, key=lambda motion: (motion.component, int(motion.keys[0])))
        return Diagnosis(
            components=space.components, free=tuple(order), complete=not unresolved, close=not order and not unresolved
        )

    def _split(self, variables: Indices) -> list[tuple[Family, Indices]]:
        """Return ascending variables by family."""
        cuts = np.searchsorted(variables, self.bounds)
        parts = [variables[a:b] for a, b in itertools.pairwise(cuts)]
        return [(f, part) for f, part in zip(self.problem.families, parts, strict=True) if len(part)]

    def _elements(self, family: Family, variables: Indices) -> Array:
        number = self.problem.families.index(family)
        return family.elements(self.packed[number][variables - self.bounds[number]])

    def _without_factor(self) -> None:
        lonely = np.flatnonzero((self.space.factors == 0) & (self.space.freedom != _DETERMINED))
        if len(lonely) == 0:
            return
        parts = self._split(lonely)
        keys = [self.keys[variables] for _, variables in parts]
        dofs = np.concatenate([np.full(len(v), f.dof) for f, v in parts])
        for dof in np.unique(dofs):
            mine = [(f, k) for (f, _), k in zip(parts, keys, strict=True) if f.dof == dof]
            every = np.sort(np.concatenate([k for _, k in mine]))
            self.free.append(
                FreeMotion(
                    keys=every,
                    variables=named_keys([k for _, k in mine], [f for f, _ in mine]),
                    kind="no factor",
                    directions=int(dof),
                    words="take any value",
                    component=int(self.space.component[lonely[0]]),
                    remedy=remedy_for("no factor", int(every[0]), alone=len(every) == 1),
                    each=True,
                )
            )

    def _parts(self, space: _Space, *, alone: bool = False) -> list[Indices]:
        """Tell what is free in each part, or only in single variables; return the parts that are unresolved."""
        unresolved, single, told = [], [], 0
        for number, variables in enumerate(space.parts()):
            if len(variables) == 0 or space.factors[variables[0]] == 0:
                continue
            if len(variables) == 1:
                single.append(int(variables[0]))
            elif space.freedom[variables[0]] == _UNRESOLVED:
                unresolved.append(variables)
            elif told < _MAX_PARTS and not alone:
                _, dofs = self.problem.tangents(variables)
                motion = space.motion_of_part(variables, dofs, int(space.columns[number]))
                told += self._tell(variables, self.sensitivities.free(variables, motion))
        if single:
            self._alone(np.array(single, dtype=np.int64))
        return unresolved

    def _tell(self, variables: Indices, basis: Array) -> bool:
        if basis.shape[1] == 0:
            return False
        parts = self._split(variables)
        self.free.extend(
            describe_free(
                basis,
                [self.keys[v] for _, v in parts],
                [f for f, _ in parts],
                [self._elements(f, v) for f, v in parts],
                int(self.space.component[variables[0]]),
            )
        )
        return True

    def _alone(self, variables: Indices) -> None:
        """Tell what is free in variables whose neighbours are all determined: alike ones together."""
        for family, mine in self._split(np.sort(variables)):
            found = self.sensitivities.free_alone(mine, family.dof)
            alike: dict[tuple[int, int], list[int]] = {}
            for variable, basis in found.items():
                where = int(self.space.component[variable])
                alike.setdefault((where, basis.shape[1]), []).append(variable)
            for (where, directions), members in alike.items():
                if len(members) == 1:
                    self._tell(np.array(members), found[members[0]])
                    continue
                keys = np.sort(self.keys[members])
                count = f"{directions} of {family.dof} directions"
                self.free.append(
                    FreeMotion(
                        keys=keys,
                        variables=named_keys([keys], [family]),
                        kind="other",
                        directions=directions,
                        words=f"move in {count}",
                        component=where,
                        remedy=remedy_for("other", int(keys[0]), alone=True),
                        each=True,
                    )
                )

    def _unresolved(self, parts: Sequence[Indices]) -> None:
        """Look for motions of the whole, and with one variable assumed to be known, for what hangs on the rest."""
        assumed, floating = [], False
        for variables in parts[:_MAX_PARTS]:
            mine = self._split(variables)
            motions = world_motions([f for f, _ in mine], [self._elements(f, v) for f, v in mine])
            floating |= self._tell(variables, self.sensitivities.free(variables, motions.columns))
            ranks = np.concatenate([np.full(len(v), 0 if f.lie is None else f.dof) for f, v in mine])
            assumed.append(int(variables[np.argmax(ranks)]))
        space = _Space(self.problem, np.array(assumed, dtype=np.int64))
        if not space.determined:
            self._parts(space, alone=floating)  # what floats would be told again

    def _iterate(self, variables: Indices) -> None:
        """Look for free motions by inverse iteration on the factor."""
        problem = self.problem
        damping = _DAMPING
        while problem.factorize(damping, np.finfo(float).tiny) is not None:
            damping *= 10.0
            if damping > 1e-6:
                return
        scalars = int(problem.native.plan()["scalars"])
        if damping == _DAMPING and _core.graph_least_pivot(problem.native) > 1e4 * damping * scalars:
            return
        rows = self.sensitivities.tangent_rows(variables)
        D = problem.native.diagonal()
        root = np.sqrt(np.where(D > 0.0, D, 1.0))
        X = np.zeros((_COLUMNS, len(D)))
        X[:, rows] = np.random.default_rng(0).normal(size=(_COLUMNS, len(rows))) / root[rows]
        for _ in range(_ROUNDS):
            X = problem.native.solve_for(np.ascontiguousarray(X * D))
            X = np.ascontiguousarray(np.linalg.qr((X * root).T)[0].T / root)
        self._tell(variables, self.sensitivities.free(variables, X[:, rows].T))
