"""Which start a graph is solved from: the given one, or the chordal one where that promises more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.errors import GraphError
from heliograph.graph.batch.chordal import chordal_values
from heliograph.graph.batch.outcome import Minimum
from heliograph.graph.batch.solution import POOR_COST
from heliograph.graph.model.families import FAMILIES
from heliograph.graph.model.values import Values
from heliograph.graph.problem.problem import Cost, Problem
from heliograph.lie import SE2, SE3, SO2, SO3

__all__ = ["Start", "choose_start", "second_start"]

# What pulls a solver into a wrong valley is rotations, and only large errors of them. On the public pose graphs from
# odometry no rotation is off by more than 1 rad where Newton-like solvers find the optimum (M3500, intel, kitti, CSAIL,
# sphere2500, parking-garage, cubicle), and 0.2 % to 75 % of them are where they fail or take long (torus3D,
# sphere_bignoise, MIT, ais2klinik, city10000, w10000, w20000).
_POOR_ANGLE = 1.0  # [rad]
_POOR_SHARE = 1e-3
# In space a chordal start costs about one step of the solver, and saves three of six on sphere2500, where a sixth of
# the rotations are off by more than this.
_WIDE_ANGLE = 0.3
_WIDE_SHARE = 0.05

_FEW = 20

_BETWEEN = 2
_TURNS = {FAMILIES[SO2]: 1, FAMILIES[SE2]: 1, FAMILIES[SO3]: 3, FAMILIES[SE3]: 3}


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where a solver starts.

    Parameters
    ----------
    cost : Cost
        There; the problem is linearised there.
    text : str
        Which start it is and why.
    """

    cost: Cost
    text: str


def choose_start(problem: Problem, values: Values, initial: str, given: Cost) -> Start:
    """Set the problem to its start and linearise it there.

    Parameters
    ----------
    problem : Problem
        Linearised at `values`.
    values : Values
        As given.
    initial : str
        ``given``; ``chordal``; or ``auto``: the chordal start is computed where many rotations are far off, and taken
        where its cost is lower.
    given : Cost
        At `values`.

    Raises
    ------
    GraphError
        A chordal start was asked for, but the graph has none.
    """
    why = "asked for" if initial == "chordal" else _far_off(problem) if initial == "auto" else ""
    if not why:
        return Start(cost=given, text="given")
    chordal = _chordal(problem, values)
    if chordal is None:
        if initial == "auto":
            return Start(cost=given, text=f"given ({why}, but the graph has no chordal start)")
        raise GraphError(
            "no chordal start: it needs between factors of poses or rotations that determine all of them; use "
            "initial='given'"
        )
    problem.set_values(chordal)
    found = problem.cost()
    told = f"chi2 {given.chi2:.6g} as given, {found.chi2:.6g} from the chordal start"
    if initial == "auto" and not found.cost < given.cost:
        problem.set_values(values)
        return Start(cost=given, text=f"given ({why}, but it costs less: {told})")
    return Start(cost=problem.linearize(), text=f"chordal ({why}: {told})")


def second_start(problem: Problem, values: Values, end: Minimum) -> Start | None:
    """Return a better start if the end of a solve from the given one is a wrong valley, else None.

    The chordal start costs more than the optimum. If it costs less than where a solver ended, that was no optimum.

    Parameters
    ----------
    problem : Problem
        At the end; linearised at the better start if there is one, else as it was.
    values : Values
        As given.
    end : Minimum
        What the solver found from them.
    """
    freedom = max(problem.rows - problem.free_scalars, 1)
    settled = end.status == "converged" and end.cost <= POOR_COST * freedom
    # Who allows only a few steps gets no more of them.
    few = end.status == "max_iterations" and len(end.iterations) < _FEW
    if settled or few or end.status == "indefinite":
        return None
    chordal = _chordal(problem, values)
    if chordal is None:
        return None
    ended = problem.values()
    problem.set_values(chordal)
    found = problem.cost()
    if not found.cost < end.cost:
        problem.set_values(ended)
        return None
    told = f"the given start ended at chi2 {end.chi2:.6g}, the chordal one begins at {found.chi2:.6g}"
    return Start(cost=problem.linearize(), text=f"chordal, after the given one ({told})")


def _chordal(problem: Problem, values: Values) -> Values | None:
    order = problem.native.elimination_order().astype(np.int64)
    return chordal_values(problem.groups, values, problem.held, order=order, threads=problem.threads)


def _far_off(problem: Problem) -> str:
    """Return how many rotations are far off at the present values, or nothing if few are."""
    turned = wide = total = 0
    for index, group in enumerate(problem.groups):
        k = _TURNS.get(group.families[0], 0) if group.code == _BETWEEN else 0
        if k:
            residual = problem.native.residuals(index)[0]
            squared = np.square(residual[:, :k]).sum(axis=1)
            turned += int((squared > _POOR_ANGLE**2).sum())
            wide += int((squared > _WIDE_ANGLE**2).sum()) if k == 3 else 0
            total += len(residual)
    if turned > _POOR_SHARE * total:
        return f"the given one has {turned} of {total} rotations off by more than {_POOR_ANGLE:g} rad"
    if wide > _WIDE_SHARE * total:
        return f"the given one has {wide} of {total} rotations off by more than {_WIDE_ANGLE:g} rad"
    return ""
