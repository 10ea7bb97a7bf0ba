"""Which start a graph is solved from: the given one, or the chordal one where the given is poor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph.errors import GraphError
from heliograph.graph.families import FAMILIES
from heliograph.graph.initialize import chordal_values
from heliograph.graph.problem import Cost, Problem
from heliograph.graph.values import Values
from heliograph.lie import SE2, SE3, SO2, SO3

__all__ = ["Start", "choose_start"]

# Honest noise gives a chi2 of about one a degree of freedom at the optimum; of the public pose graphs none starts between
# 0.7 and 20. The share of rotations tells a poor start also where the noise is stated far too large.
_POOR_CHI2 = 3.0
_POOR_ANGLE = 0.3  # [rad]
_POOR_SHARE = 0.01

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
        ``given``; ``chordal``; or ``auto``: the chordal start is computed where the given one is poor, and taken where
        its cost is lower.
    given : Cost
        At `values`.

    Raises
    ------
    GraphError
        A chordal start was asked for, but the graph has none.
    """
    if initial == "given":
        return Start(cost=given, text="given")
    why = _poor(problem, given) if initial == "auto" else "asked for"
    if not why:
        return Start(cost=given, text="given")
    chordal = chordal_values(problem.groups, values, problem.held, threads=problem.threads)
    if chordal is None:
        if initial == "auto":
            return Start(cost=given, text=f"given ({why}; the graph has no chordal start)")
        raise GraphError(
            "no chordal start: it needs between factors of poses or rotations that determine all of them; use "
            "initial='given'"
        )
    problem.set_values(chordal)
    found = problem.cost()
    told = f"chi2 {given.chi2:.6g} as given, {found.chi2:.6g} from the chordal start"
    if initial == "auto" and not found.cost < given.cost:
        problem.set_values(values)
        return Start(cost=given, text=f"given ({why}; {told})")
    return Start(cost=problem.linearize(), text=f"chordal ({why}; {told})")


def _poor(problem: Problem, given: Cost) -> str:
    """Return why the present values are a poor start, or nothing."""
    freedom = max(problem.rows - problem.free_scalars, 1)
    if given.chi2 > _POOR_CHI2 * freedom:
        return f"the given start is poor: chi2 is {given.chi2 / freedom:.3g} a degree of freedom"
    turned = total = 0
    for index, group in enumerate(problem.groups):
        k = _TURNS.get(group.families[0], 0) if group.code == _BETWEEN else 0
        if k:
            residual = problem.native.residuals(index)[0]
            turned += int((np.square(residual[:, :k]).sum(axis=1) > _POOR_ANGLE**2).sum())
            total += len(residual)
    if turned > _POOR_SHARE * total:
        return f"the given start is poor: {turned} of {total} rotations are off by more than {_POOR_ANGLE} rad"
    return ""
